"""A chain: a product of sparse factors. T is near light plus a sum of chains (docs/mathematics.md 3 and 4).

Far light is the chain U M D: D gathers the picture's light onto cells, M mixes the cells, and U scatters their light.
Blurred light is the chain B P, without a mix. The same type holds the factors as matrices (`SparseRows`), packed for a
GPU (`RowMap`), or prepared for the CPU.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, brief

Light = NDArray[np.floating]


class Operator(Protocol):
    """A matrix per channel."""

    def apply(self, picture: Light, /) -> FloatArray: ...
    def apply_transpose(self, picture: Light, /) -> FloatArray: ...


F = TypeVar("F", covariant=True)
M = TypeVar("M", covariant=True)
G = TypeVar("G")
H = TypeVar("H")


@dataclass(frozen=True)
class Chain(Generic[F, M]):
    """Factors that are applied in order: gather, mix, scatter.

    gather : D or P, picture -> cells.
    mix : M, cells -> cells; None for blurred light.
    scatter : U or B, cells -> picture.
    """

    gather: F
    mix: M
    scatter: F

    __repr__ = brief

    @property
    def factors(self: "Chain[G, G | None]") -> tuple[G, ...]:
        """The factors in the order of application."""
        return (self.gather, self.scatter) if self.mix is None else (self.gather, self.mix, self.scatter)

    def each(self: "Chain[G, G | None]", change: Callable[[G], H]) -> "Chain[H, H | None]":
        """Return the chain with every factor changed."""
        return Chain(change(self.gather), None if self.mix is None else change(self.mix), change(self.scatter))

    def apply(self: "Chain[Operator, Operator | None]", picture: Light) -> FloatArray:
        return np.asarray(reduce(lambda light, factor: factor.apply(light), self.factors, picture), np.float64)

    def apply_transpose(self: "Chain[Operator, Operator | None]", picture: Light) -> FloatArray:
        found = reduce(lambda light, factor: factor.apply_transpose(light), reversed(self.factors), picture)
        return np.asarray(found, np.float64)


@dataclass(frozen=True)
class Sum:
    """The sum of one or more operators; T is the sum of S, B P and U M D."""

    parts: Sequence[Operator]

    def apply(self, picture: Light) -> FloatArray:
        return np.asarray(reduce(np.add, (part.apply(picture) for part in self.parts)), np.float64)

    def apply_transpose(self, picture: Light) -> FloatArray:
        return np.asarray(reduce(np.add, (part.apply_transpose(picture) for part in self.parts)), np.float64)
