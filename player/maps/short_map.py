"""Row maps with weights of 16 bits, and what the rounding changes at most."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import FloatArray, RowMap, unpack

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
    largest = max(float(np.abs(packed.entries[..., :3]).max()), 1e-30)
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
    weights, scale = packed.entries[..., :3], half_scale(packed)
    entries = packed.entries.copy()
    entries[..., :3] = to_half(weights, scale).astype(np.float32) / scale
    lost = replace(packed, entries=np.concatenate([np.abs(entries[..., :3] - weights), entries[..., 3:]], -1))
    return replace(packed, entries=entries), max(_row_sums(lost, brightest), default=0.0)


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
    _, error = in_half(maps.correction, maps.mixing.brightest(white, ambient).reshape(-1, 3))
    return Rounding(half_scale(maps.correction), left_out * max(1.0, white / maps.white) + error, allowed)


def _row_sums(packed: RowMap, brightest: NDArray[np.floating]) -> Iterator[float]:
    """The largest Σ_j |w_ij| u_j of each channel."""
    rows = unpack(packed)
    if rows.indices.size:
        owner = np.repeat(np.arange(rows.lengths.size), rows.lengths)
        for i in range(3):
            yield float(np.bincount(owner, rows.weights[:, i] * brightest[rows.indices, i]).max())
