"""Row maps with weights of 16 bits, and what the rounding changes at most."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import FloatArray, RowMap, in_blocks

LARGEST_HALF = float(np.finfo(np.float16).max)  # as a float16, quotients and logarithms with it would be rounded, too
SMALLEST_HALF = float(np.finfo(np.float16).smallest_normal)  # a GPU may take smaller ones for 0
CODES = 255


@dataclass(frozen=True)
class Rounding:
    """What 16-bit weights would do to a room's correction map.

    scale : the power of two that brings the weights into the range of halves.
    change : certified change of a pixel's drive by what the map left out and by this rounding together.
    allowed : what the map was built for (`--max-error`), drive.
    """

    scale: np.float32
    change: float
    allowed: float

    @property
    def certified(self) -> bool:
        return self.change <= self.allowed


def half_scale(packed: RowMap) -> np.float32:
    """The largest power of two that keeps the weights, multiplied by it, within the range of halves."""
    weights = packed.entries[..., :3]
    largest = max(float(weights.max()), -float(weights.min()), 1e-30)
    return np.float32(2.0 ** np.floor(np.log2(LARGEST_HALF / largest)))


def to_half(weights: FloatArray, scale: np.float32) -> NDArray[np.float16]:
    """scale · weights as halves; what would be denormal is 0."""
    halves = (weights * scale).astype(np.float16)
    halves[np.abs(halves) < SMALLEST_HALF] = 0
    return halves


def in_half(packed: RowMap, brightest: NDArray[np.floating]) -> tuple[RowMap, float]:
    """The map with weights of 16 bits, scaled by a power of two into their range, and the certified change of a drive.

    δ_i = Σ_j |T⁺_ij − half(T⁺_ij)| u_j is the largest change of a desired light within u.
    brightest : u, (source pixels, 3).
    """
    scale, entries = half_scale(packed), packed.entries.copy()
    entries[..., :3] = to_half(entries[..., :3], scale).astype(np.float32) / scale
    return replace(packed, entries=entries), _change(packed, scale, brightest)


def rounding_of(maps: RoomMaps, white: float, ambient: NDArray[np.float32]) -> Rounding | None:
    """What halves would do to the correction map; None if its manifest states no bound that they could keep.

    The bound of what was left out holds for light up to the map's own white, and grows with one above that.
    ambient : in screen primaries, (camera height, camera width, 3).
    """
    try:
        allowed = float(maps.details["options"]["max_error_codes"]) / CODES
        left_out = float(maps.details["certified"]["truncation_drive"])
    except (KeyError, TypeError, ValueError):
        return None
    scale = half_scale(maps.correction)
    error = _change(maps.correction, scale, maps.mixing.brightest(white, ambient).reshape(-1, 3))
    return Rounding(scale, left_out * max(1.0, white / maps.white) + error, allowed)


def _change(packed: RowMap, scale: np.float32, brightest: NDArray[np.floating]) -> float:
    """The largest δ_i of `in_half`, found block by block."""
    largest = 0.0
    for _, rows in in_blocks(packed):
        lost = np.abs(to_half(rows.weights, scale).astype(np.float32) / scale - rows.weights)
        if lost.size:
            sums = replace(rows, weights=lost * brightest[rows.indices]).sums()
            largest = max(largest, float(sums.max()))
    return largest
