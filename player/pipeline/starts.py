"""The starts of refinement: the drive that the first step of a frame improves."""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

import numpy as np

from counterlight.passes.combine import Combine
from counterlight.passes.drawing import Picture
from counterlight.pipeline.device import Device, Owner, Owning
from counterlight.pipeline.refinement import GREY

Targets = TypeVar("Targets")  # type of the views' targets, from which a drive is made


class Iterate(NamedTuple, Generic[Picture]):
    """p and y of player/pipeline/refinement.py, and the number of steps since the last cut."""

    p: Picture
    y: Picture
    steps: int


def standing(drive: Picture) -> Iterate[Picture]:
    """Return a drive as an iterate without momentum."""
    return Iterate(drive, drive, 0)


class MapStart(Generic[Targets, Picture]):
    """Starts from clamp(T⁺ b), the thesis' method, or from direct mapping. correct : b -> p within 0..1."""

    def __init__(self, correct: Callable[[Targets], Picture]) -> None:
        self._correct = correct

    def advance(self, *, cut: bool) -> None:
        """Does nothing: no state is carried over."""

    def run(self, b: Targets) -> Iterate[Picture]:
        return standing(self._correct(b))

    def keep(self, last: Iterate[Picture]) -> None:
        """Does nothing: no state is carried over."""

    def release(self) -> None:
        """Does nothing: no resources are held."""


class PreviousStart(Owning, Generic[Targets, Picture]):
    """Starts from p = clamp(T⁺ b + k), y = p + v.

    k is the change by refinement in the previous frame: the frame's last p minus
    the frame's T⁺ b. v is the frame's final momentum, y minus p. Both are 0 after a cut.

    correct : b -> T⁺ b, or direct mapping, not clamped.
    """

    def __init__(self, device: Device[Picture], shape: tuple[int, int], correct: Callable[[Targets], Picture]) -> None:
        self._correct, self._owner = correct, Owner()
        own = self._owner.own
        self._start, self._ahead = (own(device.canvas(shape)) for _ in range(2))
        self._before, self._now = (own(_Carried(device, shape)) for _ in range(2))

    def advance(self, *, cut: bool) -> None:
        """Prepare for a new frame; `cut` : whether the frame is unrelated to the previous frame."""
        self._before, self._now = self._now, self._before
        self._now.steps = 0
        if cut or not self._before.steps:
            self._before.clear()

    def run(self, b: Targets) -> Iterate[Picture]:
        """Return the start, which is the same each time that a frame is drawn."""
        self._map = self._correct(b)
        p = self._start.draw(Combine(self._map, self._before.change.picture, clamp=True))
        return Iterate(p, self._ahead.draw(Combine(p, self._before.momentum.picture)), self._before.steps)

    def keep(self, last: Iterate[Picture]) -> None:
        """Store what refinement changed, for the next frame."""
        self._now.change.draw(Combine(last.p, self._map, -1.0))
        self._now.momentum.draw(Combine(last.y, last.p, -1.0))
        self._now.steps = last.steps


class _Carried(Generic[Picture]):
    """k, v and the number of steps of a frame, for the next frame."""

    def __init__(self, device: Device[Picture], shape: tuple[int, int]) -> None:
        self.change, self.momentum = (device.canvas(shape) for _ in range(2))
        self.steps = 0

    def clear(self) -> None:
        self.change.clear()
        self.momentum.clear()
        self.steps = 0

    def release(self) -> None:
        self.change.release()
        self.momentum.release()


class GreyStart(Owning, MapStart[Any, Picture]):
    """Starts from uniform grey."""

    def __init__(self, device: Device[Picture], shape: tuple[int, int]) -> None:
        grey = device.picture(np.full((*shape, 3), GREY, np.float32))
        super().__init__(lambda b: grey)
        self._owner = Owner()
        self._owner.own(grey)


Start: TypeAlias = MapStart[Targets, Picture] | PreviousStart[Targets, Picture]
