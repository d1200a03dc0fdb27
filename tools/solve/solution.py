"""The result of every solver, and the interface of solvers: preparing a T is expensive, each picture is cheap."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from counterlight.arrays import FloatArray


@dataclass(frozen=True)
class Solution:
    """A projector picture.

    unclamped : (projector pixels, 3). The method's result.
    notes : information for the user about the solution, one sentence each.
    """

    unclamped: FloatArray
    notes: tuple[str, ...] = ()

    @property
    def drive(self) -> FloatArray:
        """The displayable drive, (projector pixels, 3): clamped to 0..1."""
        return np.clip(self.unclamped, 0.0, 1.0)


class Solver(Protocol):
    """A method prepared for one T."""

    def solve(self, b: FloatArray) -> Solution:
        """Solve min ‖T p − b‖². b : (camera pixels, 3), 0 where T has no row."""


class ChannelSolver(Protocol):
    """A method prepared for one channel of T."""

    def solve(self, b: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        """Return p, (projector pixels,), for b, (camera pixels,), and notes."""
