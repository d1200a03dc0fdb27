"""The starts of refinement: the drive that the first step of a frame improves."""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from counterlight.pipeline.device import Device, Light, Owner
from counterlight.pipeline.refinement import GREY

Correct: TypeAlias = Callable[[Light], Light]


class Iterate(NamedTuple):
    """p and y of player/pipeline/refinement.py, and the number of steps since the last cut."""

    p: Light
    y: Light
    steps: int


def standing(drive: Light) -> Iterate:
    """Return a drive as an iterate without momentum."""
    return Iterate(drive, drive, 0)


class MapStart:
    """Starts from clamp(T⁺ b), the thesis' method, or from direct mapping. correct : b -> p within 0..1."""

    def __init__(self, correct: Correct) -> None:
        self._correct = correct

    def advance(self, *, cut: bool) -> None:
        """Does nothing: no state is carried over."""

    def run(self, b: Light) -> Iterate:
        return standing(self._correct(b))

    def keep(self, last: Iterate) -> None:
        """Does nothing: no state is carried over."""

    def release(self) -> None:
        """Does nothing: no resources are held."""


class PreviousStart:
    """Starts from p = clamp(T⁺ b + k), y = p + v. k is the change by refinement in the previous frame: its last p minus
    its T⁺ b. v is that frame's final momentum, y minus p. Both are 0 after a cut.

    correct : b -> T⁺ b, or direct mapping, not clamped.
    """

    def __init__(self, device: Device, shape: tuple[int, int], correct: Correct) -> None:
        self._correct, self._owner = correct, Owner()
        own = self._owner.own
        self._start = own(device.make_pass("combine.frag", shape, {"CLAMP": None}, factor=1.0))
        self._ahead = own(device.make_pass("combine.frag", shape, factor=1.0))
        self._before, self._now = (own(_Carried(device, shape)) for _ in range(2))

    def advance(self, *, cut: bool) -> None:
        """Prepare for a new frame; `cut` says that it is unrelated to the previous one."""
        self._before, self._now = self._now, self._before
        self._now.steps = 0
        if cut or not self._before.steps:
            self._before.clear()

    def run(self, b: Light) -> Iterate:
        """Return the start; it is the same however often a frame is drawn."""
        self._map = self._correct(b)
        p = self._start.run(first=self._map, second=self._before.change.target)
        return Iterate(p, self._ahead.run(first=p, second=self._before.momentum.target), self._before.steps)

    def keep(self, last: Iterate) -> None:
        """Store what refinement changed, for the next frame."""
        self._now.change.run(first=last.p, second=self._map)
        self._now.momentum.run(first=last.y, second=last.p)
        self._now.steps = last.steps

    def release(self) -> None:
        self._owner.release()


class _Carried:
    """k, v and the number of steps of a frame, for the next frame."""

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
    """Starts from uniform grey."""

    def __init__(self, device: Device, shape: tuple[int, int]) -> None:
        grey = device.picture(np.full((*shape, 3), GREY, np.float32))
        super().__init__(lambda b: grey)
        self._owner = Owner()
        self._owner.own(grey)

    def release(self) -> None:
        self._owner.release()


Start: TypeAlias = MapStart | PreviousStart
