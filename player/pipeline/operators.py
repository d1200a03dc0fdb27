"""Transport as operators on three-channel pictures: sums and chains of parts, and their compensation (DESIGN 6.7).

A part has `apply` and `apply_transpose`. T = S + B P + U M D is the sum of near light, a chain of gather and scatter,
and a chain of gather, mix and scatter. T⁺ removes the far light of the compensated picture before it inverts the near
light.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.maps.room_maps import BlurredMaps, FarMaps, RoomMaps
from counterlight.maps.row_map import PreparedRows

Light = NDArray[np.floating]


class Operator(Protocol):
    """A matrix per channel."""

    def apply(self, picture: Light) -> FloatArray: ...
    def apply_transpose(self, picture: Light) -> FloatArray: ...


@dataclass(frozen=True)
class Chain:
    """Parts applied in order: D, M, U for U M D."""

    parts: Sequence[Operator]

    def apply(self, picture: Light) -> FloatArray:
        return np.asarray(reduce(lambda light, part: part.apply(light), self.parts, picture), np.float64)

    def apply_transpose(self, picture: Light) -> FloatArray:
        found = reduce(lambda light, part: part.apply_transpose(light), reversed(self.parts), picture)
        return np.asarray(found, np.float64)


@dataclass(frozen=True)
class Sum:
    """The sum of one or more parts: S, B P and U M D for T."""

    parts: Sequence[Operator]

    def apply(self, picture: Light) -> FloatArray:
        return np.asarray(reduce(np.add, (part.apply(picture) for part in self.parts)), np.float64)

    def apply_transpose(self, picture: Light) -> FloatArray:
        return np.asarray(reduce(np.add, (part.apply_transpose(picture) for part in self.parts)), np.float64)


@dataclass(frozen=True)
class Compensation:
    """T⁺ = S⁺ (1 − U M' D'), as the player applies it, without the clamp (tools/inverse/far_light.py)."""

    near_pinv: Operator
    undo: Operator | None

    def near_light(self, b: Light) -> FloatArray:
        """Return b without the far light of the compensated picture."""
        return np.asarray(b if self.undo is None else b - self.undo.apply(b), np.float64)

    def apply(self, b: Light) -> FloatArray:
        return self.near_pinv.apply(self.near_light(b))

    def apply_transpose(self, drive: Light) -> FloatArray:
        sums = self.near_pinv.apply_transpose(drive)
        return sums if self.undo is None else sums - self.undo.apply_transpose(sums)


def chained(maps: FarMaps | BlurredMaps | None) -> Chain | None:
    """Return U M D or B P of packed maps, or None."""
    return None if maps is None else Chain([PreparedRows(part) for part in maps.parts])


def compensation(maps: RoomMaps) -> Compensation:
    """Return T⁺ of packed maps."""
    return Compensation(PreparedRows(maps.correction), chained(maps.undo))


def drive_of(maps: RoomMaps, b: Light) -> FloatArray:
    """Return T⁺ b as the player computes it, not clamped. `maps.bounded` limits b to what each pixel can have."""
    if not maps.bounded:
        return compensation(maps).apply(b)
    parts: list[Operator] = [PreparedRows(maps.transport)]
    parts += [Chain([PreparedRows(part) for part in each.parts]) for each in maps.beside]
    full = Sum(parts).apply(np.ones((*maps.transport.source_shape, 3)))
    return compensation(maps).apply(maps.mixing.within(b, full.reshape(b.shape)))
