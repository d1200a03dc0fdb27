"""The best picture that a projector can show: min ½‖T p − b‖², 0 ≤ p ≤ 1, to a stated gap (docs/mathematics.md 2).

As T ≥ 0, TᵀT ≼ diag(d), d = TᵀT·1: a step −Tᵀ(T p − b)/d never overshoots, whatever T is scaled by. Nesterov's momentum
with the gradient restart of O'Donoghue and Candès (2015) and most of the over-relaxation of the optimised gradient
method (Kim and Fessler 2016) make it fast. With g the gradient at p, convexity gives
f(p) − f* ≤ Σ max(g p, g (p − 1)), which certifies how far the optimum can be.
"""

import numba
import numpy as np

from counterlight.arrays import FloatArray
from counterlight.command import track
from counterlight.maps.products import LARGE, compiled
from counterlight.pipeline.refinement import Certificate
from counterlight.tools.solve.solution import Solution
from counterlight.tools.transport.transport import CHANNELS, Transport

TOLERANCE = 1e-4
MOST_STEPS, MOST_CHEAP_STEPS = 2000, 20_000
CHECK_EVERY = 20
OVER_RELAXATION = 0.9
FINEST = 1e-6  # of ½‖b‖²: an error 60 dB below the target needs no finer certificate


class Box:
    """The optima for 0 ≤ p ≤ upper, to a relative gap of `tolerance`; the notes say the gap reached and the steps.

    An infinite `upper` is certified up to twice the largest p.  most_steps : None for thousands, more of them where one
    takes microseconds.
    """

    def __init__(
        self, T: Transport, upper: float = 1.0, tolerance: float = TOLERANCE, most_steps: int | None = None
    ) -> None:
        self._T, self._upper, self._tolerance = T, upper, tolerance
        self._large = 3 * T.shape[1] >= LARGE
        if most_steps is None:
            most_steps = MOST_STEPS if self._large else MOST_CHEAP_STEPS
        self._rounds = -(-most_steps // CHECK_EVERY)
        d = T.apply_transpose(T.composition())
        self._step = np.divide(1.0, d, out=np.zeros_like(d), where=d > 0)

    def solve(self, b: FloatArray) -> Solution:
        """b : (camera pixels, 3), 0 where T has no row."""
        p, notes = self.run(b)
        return Solution(p, tuple(f"{name}: {note}" for name, note in zip(CHANNELS, notes, strict=True)))

    def run(self, b: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        """p (projector pixels, 3), and a note for each channel."""
        p = np.where(self._step > 0, 0.5, 0.0)
        y, momentum, steps = p, np.ones(3), 0
        projected, extrapolated = _PROJECTED[self._large], _EXTRAPOLATED[self._large]
        gap = self._relative_gap(b, p)
        for _ in track(range(self._rounds), f"projected gradient, {CHECK_EVERY} steps each"):
            if (gap <= self._tolerance).all():
                break
            for _ in range(CHECK_EVERY):
                descent = self._T.apply_transpose(b - self._T.apply(y))
                following, against = projected(y, p, descent, self._step, self._upper)
                momentum[against > 0] = 1.0
                larger = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
                y = extrapolated(y, p, following, (momentum - 1) / larger)
                p, momentum = following, larger
            steps += CHECK_EVERY
            gap = self._relative_gap(b, p)
        limits = ("" if one <= self._tolerance else ", its limit" for one in gap)
        return p, tuple(
            f"relative gap {g:.1e} after {steps} steps{limit}" for g, limit in zip(gap, limits, strict=True)
        )

    def _relative_gap(self, b: FloatArray, p: FloatArray) -> FloatArray:
        return relative_gap(certificate(self._T, b, p, self._upper), b)


def _projected(
    y: FloatArray, p: FloatArray, descent: FloatArray, step: FloatArray, upper: float
) -> tuple[FloatArray, FloatArray]:
    """The step from y, limited to the box (n, 3), and (y − it)·(it − p), above 0 where momentum leads uphill (3,)."""
    following = np.empty_like(y)
    red, green, blue = 0.0, 0.0, 0.0
    for j in numba.prange(len(y)):
        for i in range(3):
            following[j, i] = min(max(y[j, i] + step[j, i] * descent[j, i], 0.0), upper)
        red += (y[j, 0] - following[j, 0]) * (following[j, 0] - p[j, 0])
        green += (y[j, 1] - following[j, 1]) * (following[j, 1] - p[j, 1])
        blue += (y[j, 2] - following[j, 2]) * (following[j, 2] - p[j, 2])
    return following, np.array([red, green, blue])


def _extrapolated(y: FloatArray, p: FloatArray, following: FloatArray, momentum: FloatArray) -> FloatArray:
    """The next y (n, 3).  momentum : (3,)."""
    result = np.empty_like(y)
    for j in numba.prange(len(y)):
        for i in range(3):
            q = following[j, i]
            result[j, i] = q + momentum[i] * (q - p[j, i]) + OVER_RELAXATION * (q - y[j, i])
    return result


_PROJECTED, _EXTRAPOLATED = compiled(_projected), compiled(_extrapolated)


def certificate(T: Transport, b: FloatArray, drive: FloatArray, upper: float = 1.0) -> Certificate:
    """The bound at any 0 ≤ p ≤ upper, (projector pixels, 3); b : (camera pixels, 3), 0 where T has no row."""
    residual = T.apply(drive) - b
    gradient = T.apply_transpose(residual)
    reach = upper if np.isfinite(upper) else np.maximum(1.0, 2 * drive.max(axis=0, initial=0.0))
    gap = np.maximum(gradient * drive, gradient * (drive - reach)).sum(axis=0)
    return Certificate(np.sum(residual**2, axis=0), gap)


def relative_gap(found: Certificate, b: FloatArray) -> FloatArray:
    """The gap as a share of f(p), (3,), or of ½‖b‖² 60 dB down if f(p) is smaller than that."""
    scale = np.maximum(found.squared_error, FINEST * np.sum(b**2, axis=0)) / 2
    return np.asarray(np.divide(found.gap, scale, out=np.zeros_like(scale), where=scale > 0))
