"""Damping of the drive from frame to frame, against flicker."""

from counterlight.pipeline.content import Succession
from counterlight.pipeline.device import Device, Light


class Damper:
    """Computes (1 − weight) drive + weight · previous drive. After a cut or a gap, the drive is unchanged."""

    def __init__(self, device: Device, shape: tuple[int, int]) -> None:
        self._succession = Succession(lasting=False)
        self._before, self._now = (device.make_pass("blend.frag", shape) for _ in range(2))
        self._before.clear()

    def advance(self, *, cut: bool) -> None:
        if self._succession.advance(cut=cut):
            self._before, self._now = self._now, self._before

    def restart(self) -> None:
        self._succession.restart()

    def run(self, drive: Light, weight: float) -> Light:
        self._now.set(weight=0.0 if self._succession.fresh else weight)
        self._succession.draw()
        return self._now.run(now=drive, before=self._before.target)

    def release(self) -> None:
        self._before.release()
        self._now.release()
