"""A room's light T = S + U M D and its transpose in small words, certified (small_map.py, docs/gpu.md).

S and U share one picture of colours, so that a residual times w C is the source of Sᵀ and Uᵀ alike. No drive within
0..1 changes the camera's picture by more than `Small.allowed`: half a code value of white, or of a pixel's own full light
where that is less. Of that S may take NEAR where there is far light, and U, M and D a third of the rest each:

    Û M̂ D̂ − U M D = (Û − U) M D + Û (M̂ − M) D + Û M̂ (D̂ − D).

Before, U, M and D are evened by diagonals, U β⁻¹ · β M α⁻¹ · α D, so that cells hold about 1 at full drive: the
entries of a row are then about of one size.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.maps.room_maps import FarMaps, RefinementMaps, RoomMaps
from counterlight.maps.row_map import RowMap, SparseRows, unpack
from counterlight.maps.small_fit import Fit, fit
from counterlight.maps.small_map import FARTHEST_JUMP, FULL_TRUST, SmallMap, without_nothing

CODES = 255
MOST_CODES = 0.5  # of white in the camera's picture; less where the map was built with a smaller --max-error
DARKEST = 1 / 32  # of white: pixels that full drive lights less may change as much as one that it lights so
NEAR = 0.5
LEAST = 1e-30


@dataclass(frozen=True)
class SmallLight:
    """What takes the place of a room's maps, by the identity of each.

    change : the most that a drive's picture is off, code values of white.  allowed : what it was to keep.
    """

    maps: dict[int, SmallMap]
    change: float
    allowed: float

    @property
    def certified(self) -> bool:
        return self.change <= self.allowed

    def of(self, packed: RowMap) -> SmallMap | None:
        return self.maps.get(id(packed))


def small_light(maps: RoomMaps, white: float) -> SmallLight | None:
    """The maps of T and Tᵀ in small words; None without refinement, or where the manifest says no --max-error.

    white : of what is shown.
    """
    try:
        codes = min(float(maps.details["options"]["max_error_codes"]), MOST_CODES)
    except (KeyError, TypeError, ValueError):
        return None
    if maps.refinement is None or codes <= 0 or max(_sizes(maps)) > FARTHEST_JUMP:
        return None
    near = unpack(maps.transport)
    far = None if maps.far is None else _Far.balanced(maps.far)
    full = near.sums() + (0.0 if far is None else far.light)
    most = np.clip(full, DARKEST * white, white)
    trust = np.rint(FULL_TRUST * maps.refinement.weights.ravel()).astype(np.int16)
    found, change = _maps(maps, maps.refinement, near, far, codes / CODES * most, trust)
    return SmallLight(found, CODES * float((change / most).max(initial=0.0)), codes)


def _sizes(maps: RoomMaps) -> list[int]:
    return [shape[0] * shape[1] for shape in (maps.transport.source_shape, maps.transport.output_shape)]


@dataclass(frozen=True)
class _Far:
    """D, M, U, balanced, what full drive makes of each, (cells, 3) of D 1 and M D 1, and of all, (camera pixels, 3)."""

    gather: SparseRows
    mix: SparseRows
    scatter: SparseRows
    gathered: FloatArray
    mixed: FloatArray
    light: FloatArray

    @classmethod
    def balanced(cls, maps: FarMaps) -> "_Far":
        gather, mix, scatter = (unpack(part) for part in (maps.gather, maps.mix, maps.scatter))
        gathered = magnitude(gather).sums()
        mix, gather, gathered = _evened(mix, gather, gathered)
        scatter, mix, mixed = _evened(scatter, mix, times(magnitude(mix), gathered))
        return cls(gather, mix, scatter, gathered, mixed, times(magnitude(scatter), mixed))


def _evened(left: SparseRows, right: SparseRows, reach: FloatArray) -> tuple[SparseRows, SparseRows, FloatArray]:
    """L β⁻¹, β R and β reach, (columns, 3), which is 1 in the mean channel; columns that nothing reaches left out of L.

    reach : what R gives at full drive.
    """
    mean = reach.mean(axis=1)
    factors = np.divide(1.0, mean, out=np.zeros_like(mean), where=mean > 0)[:, None]
    left = replace(left, weights=left.weights * mean[left.indices, None])
    return left.inside(np.ones(left.shape[0], bool)), replace(right, weights=right.weights * factors[right.rows]), reach * factors


def scaled_columns(rows: SparseRows, factors: FloatArray) -> SparseRows:
    """factors : (columns, 3)."""
    return replace(rows, weights=rows.weights * factors[rows.indices])


def magnitude(rows: SparseRows) -> SparseRows:
    return replace(rows, weights=np.abs(rows.weights))


def times(rows: SparseRows, source: FloatArray) -> FloatArray:
    """(columns, 3) -> (rows, 3), without Numba."""
    return scaled_columns(rows, source).sums()


def _maps(
    maps: RoomMaps,
    refinement: RefinementMaps,
    near: SparseRows,
    far: _Far | None,
    allowed: FloatArray,
    trust: NDArray[np.int16],
) -> tuple[dict[int, SmallMap], FloatArray]:
    """Every map of T and Tᵀ, and the change of each camera pixel, (camera pixels, 3)."""
    chain, dual = maps.far, refinement.far_dual
    if far is None or chain is None or dual is None:
        found = fit(near, np.ones((near.columns, 3)), allowed)
        seen = _small(maps.transport, near, found, trust=trust)
        return {id(maps.transport): seen, id(refinement.dual): seen.transposed(trust > 0, None)}, found.change
    share = (1 - NEAR) / 3
    joint, is_far = _side_by_side(near, far.scatter)
    both = fit(joint, np.concatenate([np.ones((near.columns, 3)), far.mixed]), (NEAR + share) * allowed)
    seen = _small(maps.transport, near, both, ~is_far, trust)
    scatter = _small(chain.scatter, far.scatter, both, is_far, trust)
    slack = share * float((allowed / np.maximum(far.light, allowed)).min())
    mixes = fit(far.mix, far.gathered, np.maximum(slack * far.mixed, LEAST))
    gathers = fit(far.gather, np.ones((far.gather.columns, 3)), np.maximum(slack * far.gathered, LEAST))
    mix, gather = _small(chain.mix, far.mix, mixes), _small(chain.gather, far.gather, gathers)
    behind = mixes.change + times(magnitude(mix.unpacked()), gathers.change)
    found = {
        id(maps.transport): seen,
        id(chain.scatter): scatter,
        id(chain.mix): mix,
        id(chain.gather): gather,
        id(refinement.dual): seen.transposed(trust > 0, None),
        id(dual.gather): scatter.transposed(trust > 0, mix.colours),
        id(dual.mix): mix.transposed(None, gather.colours),
        id(dual.scatter): gather.transposed(None, None),
    }
    return found, both.change + times(magnitude(scatter.unpacked()), behind)


def _small(
    packed: RowMap,
    rows: SparseRows,
    found: Fit,
    chosen: NDArray[np.bool_] | None = None,
    trust: NDArray[np.int16] | None = None,
) -> SmallMap:
    """chosen : which of the codes found are this map's, (codes,)."""
    codes = found.codes if chosen is None else found.codes[chosen]
    indptr, indices = rows.indptr.astype(np.int64), rows.indices.astype(np.int32)
    shapes = packed.output_shape, packed.source_shape
    return without_nothing(SmallMap(indptr, indices, codes, *shapes, found.colours, trust, found.scale))


def _side_by_side(left: SparseRows, right: SparseRows) -> tuple[SparseRows, NDArray[np.bool_]]:
    """The columns of both in one matrix, and which entries are the right one's."""
    order = np.argsort(np.concatenate([left.rows, right.rows]), kind="stable")
    joint = SparseRows(
        left.indptr + right.indptr,
        np.concatenate([left.indices, right.indices + left.columns])[order],
        np.concatenate([left.weights, right.weights])[order],
        left.columns + right.columns,
    )
    return joint, order >= left.indices.size
