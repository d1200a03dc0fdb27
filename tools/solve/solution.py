"""What every solver returns, and what a solver is: expensive once for a T, cheap for each picture."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from counterlight.arrays import FloatArray


@dataclass(frozen=True)
class Solution:
    """A projector picture.

    unclamped : (projector pixels, 3), what the method says.
    notes : what a user should know about how it came about, one sentence each.
    """

    unclamped: FloatArray
    notes: tuple[str, ...] = ()

    @property
    def drive(self) -> FloatArray:
        """(projector pixels, 3), what a projector can show: clamped to 0..1."""
        return np.clip(self.unclamped, 0.0, 1.0)


class Solver(Protocol):
    """A method made ready for one T."""

    def solve(self, b: FloatArray) -> Solution:
        """min ‖T p − b‖²; b : (camera pixels, 3), 0 where T has no row."""


class ChannelSolver(Protocol):
    """A method made ready for one channel of T."""

    def solve(self, b: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        """p (projector pixels,) for b (camera pixels,), and notes."""
