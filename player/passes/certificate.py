"""The sums of a certificate: the gap, the error, and the light outside (pipeline/refiner.py)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.drawing import Array, Pass, Picture


@dataclass(frozen=True, eq=False)
class Gap(Pass[Picture]):
    """Each projector pixel's share of the gap, max(g p, g (p − 1)), with the gradient g = −descent."""

    shader = "gap.frag"
    descent: Picture
    p: Picture

    def fill(self: "Gap[Array]", out: Array) -> None:
        np.maximum(-self.descent * self.p, self.descent * (1 - self.p), out=out)


@dataclass(frozen=True, eq=False)
class Weighted(Pass[Picture]):
    """weights · picture, or weights · picture² if `squared`."""

    shader = "weighted.frag"
    picture: Picture
    weights: Picture
    squared: bool = False

    def fill(self: "Weighted[Array]", out: Array) -> None:
        np.multiply(self.picture**2 if self.squared else self.picture, self.weights, out=out)


@dataclass(frozen=True, eq=False)
class BlockSum(Pass[Picture]):
    """The sums of blocks of side × side pixels."""

    shader = "block_sum.frag"
    source: Picture
    side: int

    def fill(self: "BlockSum[Array]", out: Array) -> None:
        out[...] = block_sum(self.source, self.side)[: out.shape[0], : out.shape[1]]


@dataclass(frozen=True, eq=False)
class Inverse(Pass[Picture]):
    """1 / picture, or 0 where the picture is 0: step sizes from curvatures, or curvatures from step sizes."""

    shader = "inverse.frag"
    picture: Picture

    def fill(self: "Inverse[Array]", out: Array) -> None:
        out[...] = 0
        np.divide(1.0, self.picture, out=out, where=self.picture > 0)


def block_sum(picture: NDArray[np.generic], side: int) -> NDArray[np.generic]:
    """Sum blocks of side × side pixels; blocks at the right and lower edge may be smaller."""
    rows, columns = (np.arange(0, length, side) for length in picture.shape[:2])
    return np.asarray(np.add.reduceat(np.add.reduceat(picture, rows, axis=0), columns, axis=1))
