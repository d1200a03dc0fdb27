"""The best picture that a projector can show: the objective's minimum (tools/transport/objective.py), to a stated gap.

For T alone: min ½‖T p − b‖², 0 ≤ p ≤ 1. As T ≥ 0, TᵀT ≼ diag(d), d = TᵀT·1. A step −Tᵀ(T p − b)/d therefore never
overshoots, for any scale of T; the same holds with weights and a prior. Nesterov's momentum with the gradient restart
of O'Donoghue and Candès (2015), and most of the over-relaxation of the optimised gradient method (Kim and Fessler
2016), make it fast. With g the gradient at p, convexity gives f(p) − f* ≤ Σ max(g p, g (p − 1)), which bounds the
distance from the optimum.
"""

import numba
import numpy as np

from counterlight.arrays import FloatArray
from counterlight.command import track
from counterlight.maps.products import LARGE, compiled
from counterlight.tools.jobs import one_thread
from counterlight.tools.solve.solution import Solution
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import CHANNELS, Transport

TOLERANCE = 1e-4
MOST_STEPS, MOST_CHEAP_STEPS = 2000, 20_000
CHECK_EVERY = 20
OVER_RELAXATION = 0.9


class Box:
    """Finds the optimum for 0 ≤ p ≤ upper, to a relative gap of `tolerance`; notes state the reached gap and the steps.

    upper : limit of p. For infinity, the gap is certified for drives up to twice the largest p.
    most_steps : None for thousands, or ten times as many if a step takes microseconds.
    """

    def __init__(
        self, T: Transport | Objective, upper: float = 1.0, tolerance: float = TOLERANCE, most_steps: int | None = None
    ) -> None:
        """T : transport of the camera pixels that count, all weighted equally; or an objective with weights."""
        self._objective = T if isinstance(T, Objective) else Objective.plain(T)
        self._upper, self._tolerance, self._step = upper, tolerance, self._objective.step_size
        self._large = self._step.size >= LARGE
        if most_steps is None:
            most_steps = MOST_STEPS if self._large else MOST_CHEAP_STEPS
        self._rounds = -(-most_steps // CHECK_EVERY)

    def solve(self, b: FloatArray) -> Solution:
        """Solve for b, (camera pixels, 3), 0 where T has no row."""
        p, notes = self.run(b)
        return Solution(p, tuple(f"{name}: {note}" for name, note in zip(CHANNELS, notes, strict=True)))

    def run(self, b: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        """Return p, (projector pixels, 3), and a note per channel."""
        with one_thread():  # with more threads, far light's small products take up to 28 times as long
            return self._run(b)

    def _run(self, b: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        b = self._objective.bounded(b)
        p = np.where(self._step > 0, 0.5, 0.0)
        y, momentum, steps = p, np.ones(3), 0
        projected, extrapolated = _PROJECTED[self._large], _EXTRAPOLATED[self._large]
        gap = self._relative_gap(b, p)
        for _ in track(range(self._rounds), f"projected gradient, {CHECK_EVERY} steps each"):
            if (gap <= self._tolerance).all():
                break
            for _ in range(CHECK_EVERY):
                following, against = projected(y, p, self._objective.descent(y, b), self._step, self._upper)
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
        return self._objective.relative_gap(p, b, self._upper)


def _projected(
    y: FloatArray, p: FloatArray, descent: FloatArray, step: FloatArray, upper: float
) -> tuple[FloatArray, FloatArray]:
    """Return the step from y limited to the box, q (n, 3), and (y − q)·(q − p), (3,): positive where momentum is
    uphill.
    """
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
    """Return the next y, (n, 3). momentum : (3,)."""
    result = np.empty_like(y)
    for j in numba.prange(len(y)):
        for i in range(3):
            q = following[j, i]
            result[j, i] = q + momentum[i] * (q - p[j, i]) + OVER_RELAXATION * (q - y[j, i])
    return result


_PROJECTED, _EXTRAPOLATED = compiled(_projected), compiled(_extrapolated)
