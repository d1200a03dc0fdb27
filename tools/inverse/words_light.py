"""Packs a room's light T = S + U M D and its transpose in words of 4 bytes, certified (maps/small_map.py, docs/gpu.md).

S and U share one picture of colours, so that a residual times w C is the source of both Sᵀ and Uᵀ. For any drive in
0..1, the camera picture changes by at most `allowed`: half a code value of white, or of a pixel's own full light if
that is less. S may use the share NEAR of this if there is far light; U, M and D may use a third of the rest each:

    Û M̂ D̂ − U M D = (Û − U) M D + Û (M̂ − M) D + Û M̂ (D̂ − D).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from math import prod

import numpy as np
from numpy.typing import NDArray

from counterlight import memory
from counterlight.arrays import FloatArray
from counterlight.maps.room_maps import MapChain, RefinementMaps, RoomMaps
from counterlight.maps.row_map import RowMap, SparseRows, bands, in_blocks, next_to_each_other, rows_between, unpack
from counterlight.maps.small_map import FARTHEST_JUMP, FULL_TRUST, SmallMap
from counterlight.maps.word_map import MOST_WORDS, RoomWords, WordMap
from counterlight.tools.inverse.words_fit import Fit, fit, scale_of

CODES = 255
# largest change of the camera picture in 8-bit code values; less if the map was built with a smaller --max-error
MOST_CODES = 0.5
DARKEST = 1 / 32  # share of white; in darker pixels, the same change is allowed as in a pixel of this brightness
NEAR = 0.5
USED = 0.8  # share of the allowed change that is used; words then stay valid while a lamp dims by a fifth
LEAST = 1e-30
ENTRY_BYTES = 200  # per entry of T during work


@dataclass(frozen=True)
class SmallLight:
    """The maps of T and Tᵀ by name (RoomMaps.named), and the largest used share of the allowed change."""

    maps: dict[str, SmallMap]
    used: float


def words_of_light(maps: RoomMaps, max_error: float) -> SmallLight | None:
    """Return words that replace T and Tᵀ; None without refinement.

    max_error : truncation of the maps, in code values.
    """
    if maps.refinement is None or max_error <= 0 or max(_sizes(maps)) > FARTHEST_JUMP:
        return None
    far = None if maps.far is None else _Far.of(maps.far)
    seen = _Seen.of(maps, far)
    allowed = min(max_error, MOST_CODES) / CODES * np.clip(seen.full, DARKEST * maps.white, maps.white)
    trust = np.rint(FULL_TRUST * np.where(_heard(maps.refinement), maps.refinement.weights.ravel(), 0)).astype(np.int16)
    found, change = _maps(maps, seen, far, USED * allowed, trust)
    return SmallLight(found, float((change / allowed).max(initial=0.0)))


def _heard(refinement: RefinementMaps) -> NDArray[np.bool_]:
    """Return whether each camera pixel influences TᵀW, (camera pixels,) bool."""
    heard = np.zeros(refinement.weights.size, bool)
    for packed in (refinement.dual, *([refinement.far_dual.gather] if refinement.far_dual else [])):
        for _, rows in in_blocks(packed):
            heard[rows.indices] = True
    return heard


def _sizes(maps: RoomMaps) -> list[int]:
    return [shape[0] * shape[1] for shape in (maps.transport.source_shape, maps.transport.output_shape)]


@dataclass(frozen=True)
class _Far:
    """D, M without the cells that no drive reaches, and D 1 and M D 1, (cells, 3)."""

    gather: SparseRows
    mix: SparseRows
    gathered: FloatArray
    mixed: FloatArray

    @classmethod
    def of(cls, maps: MapChain) -> "_Far":
        gather, mix = (unpack(part).ascending() for part in maps.factors[:2])
        gathered = magnitude(gather).sums()
        mix = mix.where(np.asarray((gathered > 0).any(axis=1))[mix.indices])
        return cls(gather, mix, gathered, magnitude(mix).apply(gathered))


@dataclass(frozen=True)
class _Seen:
    """S, and U if there is far light, read in bands, with the light of all rows.

    maps : S and U.
    reach : (columns of both, 3). Largest values of their sources.
    bands : (first row, last row), last exclusive.
    full, light : (camera pixels, 3). T 1 and U M D 1.
    """

    maps: tuple[RowMap, ...]
    reach: FloatArray
    bands: tuple[tuple[int, int], ...]
    full: FloatArray
    light: FloatArray

    @classmethod
    def of(cls, room: RoomMaps, far: _Far | None) -> "_Seen":
        maps, ones = [room.transport], np.ones((prod(room.transport.source_shape), 3))
        reach = [ones]
        if far is not None and room.far is not None:
            maps.append(room.far.scatter)
            reach.append(far.mixed)
        lengths = np.sum([packed.lookup[..., 2].ravel() for packed in maps], axis=0, dtype=np.int64)
        some = tuple(bands(np.concatenate([[0], np.cumsum(lengths)])))
        full, light = (np.zeros((lengths.size, 3)) for _ in range(2))
        seen = cls(tuple(maps), np.concatenate(reach), some, full, light)
        for first, last in some:
            near, *scattered = seen.rows(first, last)
            for U in scattered:
                light[first:last] = magnitude(U).apply(reach[1])
            full[first:last] = near.sums() + light[first:last]
        return seen

    def rows(self, first: int, last: int) -> list[SparseRows]:
        """Return the rows of S, and of U if there is far light."""
        return [rows_between(packed, first, last).ascending() for packed in self.maps]

    @property
    def scale(self) -> float:
        """The common scale of the codes of S and U."""
        weights = [packed.entries[..., :3] for packed in self.maps]
        return scale_of(max(max(float(each.max()), -float(each.min())) for each in weights))


def magnitude(rows: SparseRows) -> SparseRows:
    return replace(rows, weights=np.abs(rows.weights))


def _maps(
    maps: RoomMaps, seen: _Seen, far: _Far | None, allowed: FloatArray, trust: NDArray[np.int16]
) -> tuple[dict[str, SmallMap], FloatArray]:
    """Return every map of T and Tᵀ, and the change of each camera pixel, (camera pixels, 3)."""
    projector = maps.transport.source_shape
    if far is None or maps.far is None:
        (transport,), change = _seen_light(seen, allowed, trust)
        return {"transport": transport, "dual": transport.transposed(trust > 0, None)}, change
    share = (1 - NEAR) / 3
    (transport, scatter), change = _seen_light(seen, (NEAR + share) * allowed, trust)
    slack = share * float((allowed / np.maximum(seen.light, allowed)).min())
    mixes = fit(far.mix, far.gathered, np.maximum(slack * far.mixed, LEAST))
    gathers = fit(far.gather, np.ones((far.gather.columns, 3)), np.maximum(slack * far.gathered, LEAST))
    cells, mixed = (factor.output_shape for factor in maps.far.factors[:2])
    mix, gather = small_map((mixed, cells), far.mix, mixes), small_map((cells, projector), far.gather, gathers)
    behind = mixes.change + magnitude(mix.unpacked()).apply(gathers.change)
    for first, last in seen.bands:
        change[first:last] += magnitude(scatter.of_rows(first, last).unpacked()).apply(behind)
    found = {
        "transport": transport,
        "far_scatter": scatter,
        "far_mix": mix,
        "far_gather": gather,
        "dual": transport.transposed(trust > 0, None),
        "dual_gather": scatter.transposed(trust > 0, mix.colours),
        "dual_mix": mix.transposed(None, gather.colours),
        "dual_scatter": gather.transposed(None, None),
    }
    return found, change


def _seen_light(seen: _Seen, allowed: FloatArray, trust: NDArray[np.int16]) -> tuple[list[SmallMap], FloatArray]:
    """Return S, and U if there is far light, with shared colours; and their change, (camera pixels, 3)."""
    found: list[list[SmallMap]] = [[] for _ in seen.maps]
    change, scale = np.zeros_like(allowed), seen.scale
    for first, last in seen.bands:
        rows = seen.rows(first, last)
        joint = reduce(next_to_each_other, rows)
        both = fit(joint, seen.reach, allowed[first:last], scale)
        change[first:last] = both.change
        ends = np.cumsum([each.columns for each in rows])
        whose = np.searchsorted(ends, joint.indices, side="right")
        for number, (packed, each) in enumerate(zip(seen.maps, rows, strict=True)):
            shapes = (1, last - first), packed.source_shape
            found[number].append(small_map(shapes, each, both, whose == number))
    pairs = zip(found, seen.maps, strict=True)
    return [_below(parts, packed.output_shape, packed.source_shape, trust) for parts, packed in pairs], change


def small_map(
    shapes: tuple[tuple[int, int], tuple[int, int]],
    rows: SparseRows,
    found: Fit,
    chosen: NDArray[np.bool_] | None = None,
) -> SmallMap:
    """Make a small map.

    shapes : shapes of output and source.
    chosen : (codes,) bool. Codes that belong to this map; None for all.
    """
    codes = found.codes if chosen is None else found.codes[chosen]
    indptr, indices = rows.indptr.astype(np.int64), rows.indices.astype(np.int32)
    return without_nothing(SmallMap(indptr, indices, codes, *shapes, found.colours, scale=found.scale))


def without_nothing(small: SmallMap) -> SmallMap:
    """Drop entries whose three codes are 0."""
    return small.where(np.asarray(small.codes.any(axis=1)))


def _below(
    parts: Sequence[SmallMap], output: tuple[int, int], source: tuple[int, int], trust: NDArray[np.int16]
) -> SmallMap:
    """Stack the rows of several parts. trust : trust in all rows."""
    lengths = np.concatenate([np.diff(part.indptr) for part in parts])
    indices, codes, colours = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("indices", "codes", "colours")
    )
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    return SmallMap(indptr, indices, codes, output, source, colours, trust, parts[0].scale)


def words_of(maps: RoomMaps, max_error: float) -> RoomWords | None:
    """Return words for T and Tᵀ; None if they miss their bound, are too large, or cannot hold this kind of light.

    A texture and the available memory limit the size. Blurred light has no words.

    max_error : largest error in code values.
    """
    if maps.blurred is not None or ENTRY_BYTES * maps.transport.count > memory.available_bytes():
        return None
    found = words_of_light(maps, max_error)
    if found is None or found.used > 1 or max(small.most_words for small in found.maps.values()) > MOST_WORDS:
        return None
    return RoomWords({name: WordMap.of(small) for name, small in found.maps.items()}, found.used)
