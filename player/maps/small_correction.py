"""T⁺ in small words, certified: the share of `--max-error` that the build leaves is theirs (docs/gpu.md).

A weight of T⁺ has 13 bits in words, 11 in halves: its weights cancel, so that rounding halves alone changes a drive by
0.3 to 0.7 code values in shipped rooms. Words change it by a quarter of that, and are not certified in every room.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import RowMap, SparseRows, unpack
from counterlight.maps.small_fit import Fit, fit
from counterlight.maps.small_map import FARTHEST_JUMP, SmallMap, ascending, colours_of, without_nothing

CODES = 255


@dataclass(frozen=True)
class SmallCorrection:
    """change : certified change of a pixel's drive by what the map left out and by words together.

    allowed : what the map was built for (`--max-error`), drive.
    """

    map: SmallMap
    change: float
    allowed: float

    @property
    def certified(self) -> bool:
        return self.change <= self.allowed


def small_correction(maps: RoomMaps, white: float, ambient: NDArray[np.float32]) -> SmallCorrection | None:
    """T⁺ in words; None if its manifest states no bound that they could keep.

    The bound of what was left out holds for light up to the map's own white, and grows with one above that.
    ambient : in screen primaries, (camera height, camera width, 3).
    """
    try:
        allowed = float(maps.details["options"]["max_error_codes"]) / CODES
        left_out = float(maps.details["certified"]["truncation_drive"]) * max(1.0, white / maps.white)
    except (KeyError, TypeError, ValueError):
        return None
    height, width = maps.correction.source_shape
    if left_out >= allowed or height * width > FARTHEST_JUMP:
        return None
    brightest = maps.mixing.brightest(white, ambient).reshape(-1, 3).astype(np.float64)
    found, change = in_small(maps.correction, brightest, allowed - left_out)
    return SmallCorrection(found, left_out + change, allowed)


def in_small(packed: RowMap, brightest: FloatArray, allowed: float) -> tuple[SmallMap, float]:
    """The map in words, and the largest change of a result, Σ_j |T⁺_ij − words(T⁺_ij)| u_j, which may miss `allowed`.

    brightest : u, (source pixels, 3): what the source holds of either sign.
    """
    rows = ascending(unpack(packed))
    found = fit(rows, brightest, np.full((rows.shape[0], 3), allowed / 2))  # of each sign
    shapes = packed.output_shape, packed.source_shape
    indptr, indices = rows.indptr.astype(np.int64), rows.indices.astype(np.int32)
    small = SmallMap(indptr, indices, found.codes, *shapes, found.colours, scale=found.scale)
    return without_nothing(small), float(_lost(rows, found, brightest).max(initial=0.0))


def _lost(rows: SparseRows, found: Fit, brightest: FloatArray) -> FloatArray:
    kept = found.scale * found.codes * colours_of(found.colours)[rows.rows].astype(np.float64)
    return replace(rows, weights=np.abs(kept - rows.weights) * brightest[rows.indices]).sums()
