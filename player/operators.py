"""Light as operators on pictures of three channels: products, sums and transposes of parts (DESIGN 6.7).

A part has `apply` and `apply_transpose`. T = S + U M D is the sum of near light and a chain of gather, mix and scatter;
T⁺ takes the far light of the compensated picture out before it inverts the near light.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from counterlight.maps import FarMaps, RoomMaps
from counterlight.reference import PreparedRows
from counterlight.row_map import RowMap

FloatArray = NDArray[np.floating]
Result = NDArray[np.float64]


class Operator(Protocol):
    """A matrix for each channel."""

    def apply(self, picture: FloatArray) -> Result: ...
    def apply_transpose(self, picture: FloatArray) -> Result: ...


@dataclass(frozen=True)
class Chain:
    """Parts one after the other: D, M, U for U M D."""

    parts: Sequence[Operator]

    def apply(self, picture: FloatArray) -> Result:
        for part in self.parts:
            picture = part.apply(picture)
        return np.asarray(picture, np.float64)

    def apply_transpose(self, picture: FloatArray) -> Result:
        for part in reversed(self.parts):
            picture = part.apply_transpose(picture)
        return np.asarray(picture, np.float64)


@dataclass(frozen=True)
class Sum:
    """Parts beside each other: S and U M D for T."""

    parts: Sequence[Operator]

    def apply(self, picture: FloatArray) -> Result:
        total = self.parts[0].apply(picture)
        for part in self.parts[1:]:
            total = total + part.apply(picture)
        return total

    def apply_transpose(self, picture: FloatArray) -> Result:
        total = self.parts[0].apply_transpose(picture)
        for part in self.parts[1:]:
            total = total + part.apply_transpose(picture)
        return total


@dataclass(frozen=True)
class Compensation:
    """T⁺ = S⁺ (1 − U M' D'), as the player applies it, without the clamp (tools/inverse/far_light.py)."""

    near_inverse: Operator
    undo: Operator | None

    def near_light(self, b: FloatArray) -> Result:
        """b without the far light of the compensated picture."""
        return np.asarray(b if self.undo is None else b - self.undo.apply(b), np.float64)

    def apply(self, b: FloatArray) -> Result:
        return self.near_inverse.apply(self.near_light(b))

    def apply_transpose(self, drive: FloatArray) -> Result:
        sums = self.near_inverse.apply_transpose(drive)
        return sums if self.undo is None else sums - self.undo.apply_transpose(sums)


def chained(maps: FarMaps) -> Chain:
    """U M D of packed maps."""
    return Chain([PreparedRows(packed) for packed in (maps.gather, maps.mix, maps.scatter)])


def light(near: RowMap, far: FarMaps | None) -> Operator:
    """T, or Tᵀ, of packed maps."""
    rows = PreparedRows(near)
    return rows if far is None else Sum([rows, chained(far)])


def compensation(maps: RoomMaps) -> Compensation:
    """T⁺ of packed maps."""
    return Compensation(PreparedRows(maps.correction), None if maps.undo is None else chained(maps.undo))
