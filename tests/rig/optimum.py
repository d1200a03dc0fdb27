"""The best drive of the rig's projector by the true T: the least ½ Σ r² over counted pixels, darkest ≤ p ≤ 1.

The error of a pixel is r = T p − b, with b the target there. The method is accelerated projected gradient (Beck
and Teboulle 2009) with restarts (O'Donoghue and Candès 2015). With g the gradient at p, no picture is better by more
than G = Σ max(g (p − low), g (p − high)). This certificate ends the iteration.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.rig.rays import FloatArray
from tests.rig.view import Transport

MOST_STEPS, LOOK_EVERY = 3000, 20


@dataclass(frozen=True)
class Optimum:
    """A solution.

    drive : (projector pixels, 3).
    half_squares : ½ Σ r².
    gap : bound on the possible improvement of half_squares.
    """

    drive: FloatArray
    half_squares: float
    gap: float
    steps: int


@dataclass(frozen=True)
class Problem:
    """The problem.

    target : b, (camera pixels, 3). Light of the projector.
    counted : (camera pixels,).
    darkest, brightest : limits of the drive.
    """

    transport: Transport
    target: FloatArray
    counted: NDArray[np.bool_]
    darkest: float
    brightest: float

    def error(self, drive: FloatArray) -> FloatArray:
        """Returns r, (camera pixels, 3)."""
        return np.where(self.counted[:, None], self.transport.apply(drive) - self.target, 0)

    def clamped(self, drive: FloatArray) -> FloatArray:
        return np.clip(drive, self.darkest, self.brightest)

    def looked_at(self, drive: FloatArray, steps: int) -> Optimum:
        error = self.error(drive)
        slope = self.transport.adjoint(error)
        gap = np.maximum(slope * (drive - self.darkest), slope * (drive - self.brightest)).sum()
        return Optimum(drive, float(np.sum(error**2) / 2), float(gap), steps)


def box_optimum(problem: Problem, tolerance: float) -> Optimum:
    """Iterate until G is at most `tolerance` of ½ Σ r²."""
    transport = problem.transport
    ones = np.ones_like(transport.adjoint(problem.target))
    # T ≥ 0, so that TᵀT is below the diagonal of its row sums: steps of 1/d never overshoot.
    d = transport.adjoint(problem.counted[:, None] * transport.apply(ones))
    step = np.divide(1, d, out=np.zeros_like(d), where=d > 1e-9 * d.max())
    p = problem.clamped(np.zeros_like(ones))
    y, momentum = p, 1.0
    found = problem.looked_at(p, 0)
    for count in range(1, MOST_STEPS + 1):
        following = problem.clamped(y - step * transport.adjoint(problem.error(y)))
        if np.sum((y - following) * (following - p)) > 0:
            momentum = 1.0
        grown = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        y = following + (momentum - 1) / grown * (following - p)
        p, momentum = following, grown
        if count % LOOK_EVERY == 0:
            found = problem.looked_at(p, count)
            if found.gap <= tolerance * found.half_squares:
                break
    return found
