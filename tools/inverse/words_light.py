"""A room's light T = S + U M D and its transpose in words, certified (maps/small_map.py, docs/gpu.md).

S and U share one picture of colours, so that a residual times w C is the source of Sᵀ and Uᵀ alike. For no drive of
0..1 is the camera's picture off by more than `allowed`: half a code value of white, or of a pixel's own full light
where that is less. Of that S may take NEAR where there is far light, and U, M and D a third of the rest each:

    Û M̂ D̂ − U M D = (Û − U) M D + Û (M̂ − M) D + Û M̂ (D̂ − D).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.maps.room_maps import FarMaps, RefinementMaps, RoomMaps
from counterlight.maps.row_map import SparseRows, unpack
from counterlight.maps.small_map import FARTHEST_JUMP, FULL_TRUST, SmallMap
from counterlight.tools.inverse.words_fit import Fit, fit

CODES = 255
MOST_CODES = 0.5  # of white in the camera's picture; less where the map was built with a smaller --max-error
DARKEST = 1 / 32  # of white: pixels that full drive lights less may change as much as one that it lights so
NEAR = 0.5
USED = 0.8  # of what is allowed, so that words hold while a lamp grows dimmer by a fifth
LEAST = 1e-30


@dataclass(frozen=True)
class SmallLight:
    """The maps of T and Tᵀ by their names (RoomMaps.named), and how much of what is allowed they change at most."""

    maps: dict[str, SmallMap]
    used: float


def words_of_light(maps: RoomMaps, max_error: float) -> SmallLight | None:
    """What takes the place of T and Tᵀ; None without refinement.

    max_error : what the maps were built for, code values.
    """
    if maps.refinement is None or max_error <= 0 or max(_sizes(maps)) > FARTHEST_JUMP:
        return None
    near = ascending(unpack(maps.transport))
    far = None if maps.far is None else _Far.of(maps.far)
    full = near.sums() + (0.0 if far is None else far.light)
    allowed = min(max_error, MOST_CODES) / CODES * np.clip(full, DARKEST * maps.white, maps.white)
    trust = np.rint(FULL_TRUST * np.where(_heard(maps.refinement), maps.refinement.weights.ravel(), 0)).astype(np.int16)
    found, change = _maps(maps, near, far, USED * allowed, trust)
    return SmallLight(found, float((change / allowed).max(initial=0.0)))


def _heard(refinement: RefinementMaps) -> NDArray[np.bool_]:
    """The camera pixels that TᵀW reads, (camera pixels,)."""
    heard = np.zeros(refinement.weights.size, bool)
    for packed in (refinement.dual, *([refinement.far_dual.gather] if refinement.far_dual else [])):
        heard[unpack(packed).indices] = True
    return heard


def _sizes(maps: RoomMaps) -> list[int]:
    return [shape[0] * shape[1] for shape in (maps.transport.source_shape, maps.transport.output_shape)]


@dataclass(frozen=True)
class _Far:
    """D, M without the cells that no drive reaches, U; D 1 and M D 1, (cells, 3), and U M D 1, (camera pixels, 3)."""

    gather: SparseRows
    mix: SparseRows
    scatter: SparseRows
    gathered: FloatArray
    mixed: FloatArray
    light: FloatArray

    @classmethod
    def of(cls, maps: FarMaps) -> "_Far":
        gather, mix, scatter = (ascending(unpack(part)) for part in (maps.gather, maps.mix, maps.scatter))
        gathered = magnitude(gather).sums()
        mix = mix.where(np.asarray((gathered > 0).any(axis=1))[mix.indices])
        mixed = magnitude(mix).apply(gathered)
        return cls(gather, mix, scatter, gathered, mixed, magnitude(scatter).apply(mixed))


def magnitude(rows: SparseRows) -> SparseRows:
    return replace(rows, weights=np.abs(rows.weights))


def _maps(
    maps: RoomMaps, near: SparseRows, far: _Far | None, allowed: FloatArray, trust: NDArray[np.int16]
) -> tuple[dict[str, SmallMap], FloatArray]:
    """Every map of T and Tᵀ, and the change of each camera pixel, (camera pixels, 3)."""
    camera, projector = maps.transport.output_shape, maps.transport.source_shape
    if far is None or maps.far is None:
        alone = fit(near, np.ones((near.columns, 3)), allowed)
        seen = small_map((camera, projector), near, alone, trust=trust)
        return {"transport": seen, "dual": seen.transposed(trust > 0, None)}, alone.change
    share = (1 - NEAR) / 3
    joint, is_far = _side_by_side(near, far.scatter)
    both = fit(joint, np.concatenate([np.ones((near.columns, 3)), far.mixed]), (NEAR + share) * allowed)
    slack = share * float((allowed / np.maximum(far.light, allowed)).min())
    mixes = fit(far.mix, far.gathered, np.maximum(slack * far.mixed, LEAST))
    gathers = fit(far.gather, np.ones((far.gather.columns, 3)), np.maximum(slack * far.gathered, LEAST))
    cells, mixed = maps.far.gather.output_shape, maps.far.mix.output_shape
    seen = small_map((camera, projector), near, both, ~is_far, trust)
    scatter = small_map((camera, mixed), far.scatter, both, is_far, trust)
    mix, gather = small_map((mixed, cells), far.mix, mixes), small_map((cells, projector), far.gather, gathers)
    behind = mixes.change + magnitude(mix.unpacked()).apply(gathers.change)
    found = {
        "transport": seen,
        "far_scatter": scatter,
        "far_mix": mix,
        "far_gather": gather,
        "dual": seen.transposed(trust > 0, None),
        "dual_gather": scatter.transposed(trust > 0, mix.colours),
        "dual_mix": mix.transposed(None, gather.colours),
        "dual_scatter": gather.transposed(None, None),
    }
    return found, both.change + magnitude(scatter.unpacked()).apply(behind)


def small_map(
    shapes: tuple[tuple[int, int], tuple[int, int]],
    rows: SparseRows,
    found: Fit,
    chosen: NDArray[np.bool_] | None = None,
    trust: NDArray[np.int16] | None = None,
) -> SmallMap:
    """shapes : of output and source.  chosen : which of the codes found are this map's, (codes,)."""
    codes = found.codes if chosen is None else found.codes[chosen]
    indptr, indices = rows.indptr.astype(np.int64), rows.indices.astype(np.int32)
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


def ascending(rows: SparseRows) -> SparseRows:
    """The entries of each row in the order of their columns, as words need them."""
    order = np.lexsort((rows.indices, rows.rows))
    if (np.diff(order) == 1).all():
        return rows
    return replace(rows, indices=rows.indices[order], weights=rows.weights[order])


def without_nothing(small: SmallMap) -> SmallMap:
    """Entries whose three codes are 0 left out."""
    keep = small.codes.any(axis=1)
    kept_before = np.concatenate([[0], np.cumsum(keep)])
    return replace(small, indptr=kept_before[small.indptr], indices=small.indices[keep], codes=small.codes[keep])
