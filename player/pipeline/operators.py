"""T⁺ of packed maps as an operator on pictures (DESIGN 6.7): it removes the far light of the compensated picture."""

from dataclasses import dataclass

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.maps.chain import Chain, Light, Operator, Sum
from counterlight.maps.room_maps import MapChain, RoomMaps
from counterlight.maps.row_map import PreparedRows


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


def prepared(chain: MapChain | None) -> Chain[PreparedRows, PreparedRows | None] | None:
    """Return a chain of packed maps as an operator; None for None."""
    return None if chain is None else chain.each(PreparedRows)


def compensation(maps: RoomMaps) -> Compensation:
    """Return T⁺ of packed maps."""
    return Compensation(PreparedRows(maps.correction), prepared(maps.undo))


def drive_of(maps: RoomMaps, b: Light) -> FloatArray:
    """Return T⁺ b as the player computes it, not clamped. `maps.bounded` limits b to what each pixel can have."""
    if not maps.bounded:
        return compensation(maps).apply(b)
    chains = [chain.each(PreparedRows) for chain in maps.chains]
    full = Sum([PreparedRows(maps.transport), *chains]).apply(np.ones((*maps.transport.source_shape, 3)))
    return compensation(maps).apply(maps.mixing.within(b, full.reshape(b.shape)))
