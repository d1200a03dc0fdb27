"""Weighted sums of two pictures."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from counterlight.passes.drawing import Array, Pass, Picture, flat
from counterlight.passes.kernel import PLANE, kernel, prange, within


@dataclass(frozen=True, eq=False)
class Combine(Pass[Picture]):
    """first + factor · second, limited to 0..1 if `clamp`."""

    shader = "combine.frag"
    first: Picture
    second: Picture
    factor: float = 1.0
    clamp: bool = False

    def fill(self: "Combine[Array]", out: Array) -> None:
        one, factor = np.float32(1), np.float32(self.factor)
        combined(one, flat(self.first), factor, flat(self.second), self.clamp, flat(out))


@dataclass(frozen=True, eq=False)
class Blend(Pass[Picture]):
    """(1 − weight) now + weight · gain · before."""

    shader = "blend.frag"
    now: Picture
    before: Picture
    weight: float
    gain: float = 1.0

    def fill(self: "Blend[Array]", out: Array) -> None:
        weights = np.float32(1 - self.weight), np.float32(self.weight * self.gain)
        combined(weights[0], flat(self.now), weights[1], flat(self.before), False, flat(out))


@kernel(f"float32, {PLANE}, float32, {PLANE}, boolean, {PLANE}")
def combined(a: Any, first: Array, b: Any, second: Array, clamp: Any, out: Array) -> None:
    """Compute a · first + b · second; pictures (rows, values)."""
    for y in prange(out.shape[0]):
        for i in range(out.shape[1]):
            value = a * first[y, i] + b * second[y, i]
            out[y, i] = within(value, np.float32(0), np.float32(1)) if clamp else value
