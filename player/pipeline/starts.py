"""Where refinement starts: the drive that the first step of a frame improves (`--refine-from`)."""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from counterlight.pipeline.device import Device, Light, Owner
from counterlight.pipeline.refinement import GREY

Correct: TypeAlias = Callable[[Light], Light]


class Iterate(NamedTuple):
    """p and y of player/pipeline/refinement.py, and how many steps led there since the last cut."""

    p: Light
    y: Light
    steps: int


def standing(drive: Light) -> Iterate:
    """A drive without momentum."""
    return Iterate(drive, drive, 0)


class MapStart:
    """clamp(T⁺ b), the thesis' method, or direct mapping.  correct : b -> that, p within 0..1."""

    def __init__(self, correct: Correct) -> None:
        self._correct = correct

    def advance(self, *, cut: bool) -> None:
        """Nothing is carried over."""

    def run(self, b: Light) -> Iterate:
        return standing(self._correct(b))

    def keep(self, last: Iterate) -> None:
        """Nothing is carried over."""

    def release(self) -> None:
        """Nothing is held."""


class PreviousStart:
    """p = clamp(T⁺ b + k), y = p + v: k is what refinement changed in the frame before, its last p less its T⁺ b, and v
    the momentum that it ended with, y less p; both 0 after a cut.

    correct : b -> T⁺ b, or direct mapping, not clamped.
    """

    def __init__(self, device: Device, shape: tuple[int, int], correct: Correct) -> None:
        self._correct, self._owner = correct, Owner()
        own = self._owner.own
        self._start = own(device.make_pass("combine.frag", shape, {"CLAMP": None}, factor=1.0))
        self._ahead = own(device.make_pass("combine.frag", shape, factor=1.0))
        self._before, self._now = (own(_Carried(device, shape)) for _ in range(2))

    def advance(self, *, cut: bool) -> None:
        """A new frame comes; cut: it has nothing to do with the one before."""
        self._before, self._now = self._now, self._before
        self._now.steps = 0
        if cut or not self._before.steps:
            self._before.clear()

    def run(self, b: Light) -> Iterate:
        """Where to start; the same for one frame however often it is drawn."""
        self._map = self._correct(b)
        p = self._start.run(first=self._map, second=self._before.change.target)
        return Iterate(p, self._ahead.run(first=p, second=self._before.momentum.target), self._before.steps)

    def keep(self, last: Iterate) -> None:
        """Take what refinement made of it."""
        self._now.change.run(first=last.p, second=self._map)
        self._now.momentum.run(first=last.y, second=last.p)
        self._now.steps = last.steps

    def release(self) -> None:
        self._owner.release()


class _Carried:
    """k, v and the steps of a frame, for the next one."""

    def __init__(self, device: Device, shape: tuple[int, int]) -> None:
        self.change, self.momentum = (device.make_pass("combine.frag", shape, factor=-1.0) for _ in range(2))
        self.clear()

    def clear(self) -> None:
        self.change.clear()
        self.momentum.clear()
        self.steps = 0

    def release(self) -> None:
        self.change.release()
        self.momentum.release()


class GreyStart(MapStart):
    """The same grey everywhere."""

    def __init__(self, device: Device, shape: tuple[int, int]) -> None:
        grey = device.picture(np.full((*shape, 3), GREY, np.float32))
        super().__init__(lambda b: grey)
        self._owner = Owner()
        self._owner.own(grey)

    def release(self) -> None:
        self._owner.release()


Start: TypeAlias = MapStart | PreviousStart
