"""A step of refinement: one accelerated projected gradient step from y (pipeline/refinement.py)."""

from dataclasses import dataclass
from typing import Any, Generic

import numpy as np

from counterlight.maps.prior import pull
from counterlight.passes.drawing import Array, Draw, Pass, Picture, flat
from counterlight.passes.kernel import PLANE, kernel, prange, within


@dataclass(frozen=True, eq=False)
class Ties(Generic[Picture]):
    """The weights of a prior (counterlight.maps.prior)."""

    damping: Picture
    right: Picture
    down: Picture


@dataclass(frozen=True, eq=False)
class Step(Draw[Picture]):
    """The next p and y. Draws two pictures; devices draw it by their stepper, and the CPU by `fill_both`.

    descent : TᵀW(b − T y).
    step_size : pixels with step size 0 stay dark.
    """

    shader = "refinement_step.frag"
    descent: Picture
    y: Picture
    p: Picture
    step_size: Picture
    prior: Ties[Picture]
    momentum: float
    over_relaxation: float

    def fill_both(self: "Step[Array]", next_p: Array, next_y: Array, *, draws: bool) -> None:
        """Compute both pictures. draws : whether the prior is not 0."""
        prior = self.prior
        pictures = self.descent, self.y, self.p, self.step_size, prior.damping, prior.right, prior.down
        pace = np.float32(self.momentum), np.float32(self.over_relaxation)
        step(*(flat(picture) for picture in pictures), draws, *pace, flat(next_p), flat(next_y))


@dataclass(frozen=True, eq=False)
class Slope(Pass[Picture]):
    """TᵀW(b − T y) − P y."""

    shader = "refinement_step.frag"
    defines = {"SLOPE": None}  # noqa: RUF012
    descent: Picture
    y: Picture
    prior: Ties[Picture]

    def fill(self: "Slope[Array]", out: Array) -> None:
        np.subtract(self.descent, pull(self.y, self.prior.damping, self.prior.right, self.prior.down), out=out)


@kernel(f"{PLANE}, {PLANE}, {PLANE}, {PLANE}, {PLANE}, {PLANE}, {PLANE}, boolean, float32, float32, {PLANE}, {PLANE}")
def step(
    descent: Array,
    y: Array,
    p: Array,
    step_size: Array,
    damping: Array,
    right: Array,
    down: Array,
    draws: Any,
    momentum: Any,
    over_relaxation: Any,
    next_p: Array,
    next_y: Array,
) -> None:
    """One projected gradient step; pictures (rows, values). `draws` : whether the prior is not 0."""
    height, width = y.shape
    for row in prange(height):
        for i in range(width):
            here, slope = y[row, i], descent[row, i]
            if draws:
                pull = damping[row, i] * here
                if i + 3 < width:
                    pull += right[row, i] * (here - y[row, i + 3])
                if i >= 3:
                    pull += right[row, i - 3] * (here - y[row, i - 3])
                if row + 1 < height:
                    pull += down[row, i] * (here - y[row + 1, i])
                if row >= 1:
                    pull += down[row - 1, i] * (here - y[row - 1, i])
                slope -= pull
            size = step_size[row, i]
            q = within(here + size * slope, np.float32(0), np.float32(1)) if size > 0 else np.float32(0)
            next_p[row, i] = q
            next_y[row, i] = q + momentum * (q - p[row, i]) + over_relaxation * (q - here)
