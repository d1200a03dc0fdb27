"""The best picture that a projector can show: min ½‖T p − b‖², 0 ≤ p ≤ 1, to a stated gap (docs/mathematics.md 2).

As T ≥ 0, TᵀT ≼ diag(d), d = TᵀT·1: a step −Tᵀ(T p − b)/d never overshoots, whatever T is scaled by. Nesterov's momentum
with the gradient restart of O'Donoghue and Candès (2015) and most of the over-relaxation of the optimised gradient
method (Kim and Fessler 2016) make it fast. With g the gradient at p, convexity gives
f(p) − f* ≤ Σ max(g p, g (p − 1)), which certifies how far the optimum can be.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from counterlight.command import track
from counterlight.products import LARGE, compiled
from counterlight.tools.solve.products import CHANNELS, ChannelProducts
from counterlight.tools.solve.solution import Solution
from counterlight.tools.solve.system import LinearSystem

FloatArray = NDArray[np.float64]
TOLERANCE = 1e-4
MOST_STEPS, MOST_CHEAP_STEPS = 2000, 20_000
CHECK_EVERY = 20
OVER_RELAXATION = 0.9
FINEST = 1e-6  # of ½‖b‖²: an error 60 dB below the target needs no finer certificate


@dataclass(frozen=True)
class Certificate:
    """How far p is from the optimum f*, f(p) = ½‖T p − b‖².

    gap : a bound on f(p) − f*.
    """

    objective: float
    gap: float
    target: float

    @property
    def relative(self) -> float:
        """The gap as a share of f(p), or of ½‖b‖² 60 dB down if f(p) is smaller than that."""
        scale = max(self.objective, FINEST * self.target)
        return self.gap / scale if scale > 0 else 0.0


def solve_box(systems: Sequence[LinearSystem]) -> list[Solution]:
    """The optima for 0 ≤ p ≤ 1, to a relative gap of 1e-4; the notes say the gap reached and the steps."""
    return projected_gradient(systems, 1.0)


def projected_gradient(
    systems: Sequence[LinearSystem], upper: float, tolerance: float = TOLERANCE, most_steps: int | None = None
) -> list[Solution]:
    """The optima for 0 ≤ p ≤ upper to a relative gap; an infinite `upper` is certified up to twice the largest p.

    systems : up to three colour channels, of one shape.  most_steps : None for thousands, more of them where one takes
    microseconds.
    """
    products, count = ChannelProducts(systems), len(systems)
    target = np.zeros((systems[0].shape[0], CHANNELS))
    target[:, :count] = np.stack([system.target for system in systems], axis=1)
    d = products.apply_transpose(products.apply(np.ones((systems[0].shape[1], CHANNELS))))
    step = np.divide(1.0, d, out=np.zeros_like(d), where=d > 0)
    p = np.where(d > 0, 0.5, 0.0)
    y, momentum, steps = p, np.ones(CHANNELS), 0
    projected, extrapolated = _PROJECTED[p.size >= LARGE], _EXTRAPOLATED[p.size >= LARGE]
    found = _certificates(products, target, p, upper, count)
    if most_steps is None:
        most_steps = MOST_STEPS if p.size >= LARGE else MOST_CHEAP_STEPS
    for _ in track(range(-(-most_steps // CHECK_EVERY)), f"projected gradient, {CHECK_EVERY} steps each"):
        if all(one.relative <= tolerance for one in found):
            break
        for _ in range(CHECK_EVERY):
            descent = products.apply_transpose(target - products.apply(y))
            following, against = projected(y, p, descent, step, upper)
            momentum[against > 0] = 1.0
            larger = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
            y = extrapolated(y, p, following, (momentum - 1) / larger)
            p, momentum = following, larger
        steps += CHECK_EVERY
        found = _certificates(products, target, p, upper, count)
    return [
        Solution(drive.copy(), (f"relative gap {one.relative:.1e} after {steps} steps{_short(one, tolerance)}",))
        for drive, one in zip(p.T, found, strict=False)
    ]


def _projected(
    y: FloatArray, p: FloatArray, descent: FloatArray, step: FloatArray, upper: float
) -> tuple[FloatArray, FloatArray]:
    """The step from y, limited to the box (n, 3), and (y − it)·(it − p), above 0 where momentum leads uphill (3,)."""
    following = np.empty_like(y)
    red, green, blue = 0.0, 0.0, 0.0
    for j in numba.prange(len(y)):
        for i in range(CHANNELS):
            following[j, i] = min(max(y[j, i] + step[j, i] * descent[j, i], 0.0), upper)
        red += (y[j, 0] - following[j, 0]) * (following[j, 0] - p[j, 0])
        green += (y[j, 1] - following[j, 1]) * (following[j, 1] - p[j, 1])
        blue += (y[j, 2] - following[j, 2]) * (following[j, 2] - p[j, 2])
    return following, np.array([red, green, blue])


def _extrapolated(y: FloatArray, p: FloatArray, following: FloatArray, momentum: FloatArray) -> FloatArray:
    """The next y (n, 3).  momentum : (3,)."""
    result = np.empty_like(y)
    for j in numba.prange(len(y)):
        for i in range(CHANNELS):
            q = following[j, i]
            result[j, i] = q + momentum[i] * (q - p[j, i]) + OVER_RELAXATION * (q - y[j, i])
    return result


_PROJECTED, _EXTRAPOLATED = compiled(_projected), compiled(_extrapolated)


def _short(found: Certificate, tolerance: float) -> str:
    return "" if found.relative <= tolerance else ", its limit"


def certificate(system: LinearSystem, drive: FloatArray, upper: float = 1.0) -> Certificate:
    """The bound at any 0 ≤ p ≤ upper."""
    residual = system.apply(drive) - system.target
    return _certificate(residual, system.apply_transpose(residual), system.target, drive, upper)


def _certificates(
    products: ChannelProducts, target: FloatArray, p: FloatArray, upper: float, count: int
) -> list[Certificate]:
    residual = products.apply(p) - target
    gradient = products.apply_transpose(residual)
    return [_certificate(residual[:, i], gradient[:, i], target[:, i], p[:, i], upper) for i in range(count)]


def _certificate(
    residual: FloatArray, gradient: FloatArray, target: FloatArray, drive: FloatArray, upper: float
) -> Certificate:
    reach = upper if np.isfinite(upper) else max(1.0, 2 * float(drive.max(initial=0.0)))
    gap = float(np.sum(np.maximum(gradient * drive, gradient * (drive - reach))))
    return Certificate(0.5 * float(residual @ residual), gap, 0.5 * float(target @ target))


def relative_gap(system: LinearSystem, drive: FloatArray) -> float:
    """(f(p) − f*) / f(p) is at most this, for any 0 ≤ p ≤ 1."""
    return certificate(system, drive).relative
