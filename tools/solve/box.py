"""The best picture that a projector can show: min ½‖T p − b‖², 0 ≤ p ≤ 1, to a stated gap (docs/mathematics.md 2).

As T ≥ 0, TᵀT ≼ diag(d), d = TᵀT·1: a step −Tᵀ(T p − b)/d never overshoots, whatever T is scaled by. Nesterov's momentum
with the gradient restart of O'Donoghue and Candès (2015) makes it fast. With g the gradient at p, convexity gives
f(p) − f* ≤ Σ max(g p, g (p − 1)), which certifies how far the optimum can be.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from player.command import track
from tools.solve.solution import Solution
from tools.solve.system import LinearSystem

FloatArray = NDArray[np.float64]
TOLERANCE = 1e-4
MOST_STEPS = 2000
CHECK_EVERY = 10
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


def solve_box(system: LinearSystem) -> Solution:
    """The optimum for 0 ≤ p ≤ 1, to a relative gap of 1e-4; the note says the gap reached and the steps."""
    return projected_gradient(system, 1.0)


def projected_gradient(
    system: LinearSystem, upper: float, tolerance: float = TOLERANCE, most_steps: int = MOST_STEPS
) -> Solution:
    """The optimum for 0 ≤ p ≤ upper to a relative gap; an infinite `upper` is certified up to twice the largest p."""
    d = system.apply_transpose(system.apply(np.ones(system.shape[1])))
    lit = d > 0
    step = np.divide(1.0, d, out=np.zeros_like(d), where=lit)
    p = np.where(lit, 0.5, 0.0)
    y, momentum, steps = p, 1.0, 0
    found = certificate(system, p, upper)
    for _ in track(range(-(-most_steps // CHECK_EVERY)), f"projected gradient, {CHECK_EVERY} steps each"):
        if found.relative <= tolerance:
            break
        for _ in range(CHECK_EVERY):
            gradient = system.apply_transpose(system.apply(y) - system.target)
            following = np.clip(y - step * gradient, 0.0, upper)
            if np.dot(y - following, following - p) > 0:
                momentum = 1.0
            larger = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
            y = following + (momentum - 1) / larger * (following - p)
            p, momentum = following, larger
        steps += CHECK_EVERY
        found = certificate(system, p, upper)
    short = "" if found.relative <= tolerance else ", its limit"
    return Solution(p, (f"relative gap {found.relative:.1e} after {steps} steps{short}",))


def certificate(system: LinearSystem, drive: FloatArray, upper: float = 1.0) -> Certificate:
    """The bound at any 0 ≤ p ≤ upper."""
    residual = system.apply(drive) - system.target
    gradient = system.apply_transpose(residual)
    reach = upper if np.isfinite(upper) else max(1.0, 2 * float(drive.max(initial=0.0)))
    gap = float(np.sum(np.maximum(gradient * drive, gradient * (drive - reach))))
    return Certificate(0.5 * float(residual @ residual), gap, 0.5 * float(system.target @ system.target))


def relative_gap(system: LinearSystem, drive: FloatArray) -> float:
    """(f(p) − f*) / f(p) is at most this, for any 0 ≤ p ≤ 1."""
    return certificate(system, drive).relative
