"""Damping of the drive from frame to frame, against flicker."""

from typing import Generic

from counterlight.passes.combine import Blend
from counterlight.passes.drawing import Picture
from counterlight.pipeline.content import Succession
from counterlight.pipeline.device import Device


class Damper(Generic[Picture]):
    """Computes (1 − weight) drive + weight · previous drive. After a cut or a gap, the drive is unchanged."""

    def __init__(self, device: Device[Picture], shape: tuple[int, int]) -> None:
        self._succession = Succession(lasting=False)
        self._before, self._now = (device.canvas(shape) for _ in range(2))

    def advance(self, *, cut: bool) -> None:
        if self._succession.advance(cut=cut):
            self._before, self._now = self._now, self._before

    def restart(self) -> None:
        self._succession.restart()

    def run(self, drive: Picture, weight: float) -> Picture:
        weight = 0.0 if self._succession.fresh else weight
        self._succession.draw()
        return self._now.draw(Blend(drive, self._before.picture, weight))

    def release(self) -> None:
        self._before.release()
        self._now.release()
