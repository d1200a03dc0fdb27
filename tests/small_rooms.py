"""Small random word maps, and rooms with certified maps in words."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import RowMap, SparseRows, pack
from counterlight.maps.small_map import FRACTION_BITS, FULL_TRUST, LARGEST_CODE, MOST_SHIFT, SmallMap
from counterlight.pipeline.room import Room
from counterlight.tools.inverse.words_light import words_of


def coded(values: NDArray[np.floating]) -> NDArray[np.int32]:
    """Return the nearest integers that a word can hold, by a numpy formula."""
    values = np.clip(values, -LARGEST_CODE, LARGEST_CODE)
    unit = np.exp2(_shifts(values))
    return np.asarray(np.rint(values / unit) * unit).astype(np.int32)


def _shifts(values: NDArray[np.number]) -> NDArray[np.int64]:
    """Return the shifts, in bits, after which a number of FRACTION_BITS + 1 bits covers each value."""
    _, bits = np.frexp(values.astype(np.float64))
    return np.clip(bits.astype(np.int64) - FRACTION_BITS - 1, 0, MOST_SHIFT)


def random_small(
    rng: np.random.Generator,
    output: tuple[int, int],
    source: tuple[int, int],
    *,
    longest: int = 20,
    trusted: bool = False,
) -> SmallMap:
    """Random map with 0 to `longest` entries per row; every third has three codes, every fifth one channel."""
    rows, columns = output[0] * output[1], source[0] * source[1]
    lengths = np.minimum(rng.integers(0, longest + 1, rows), columns)
    indices = np.concatenate([np.sort(rng.choice(columns, n, replace=False)) for n in lengths]).astype(np.int32)
    codes = np.repeat(coded(LARGEST_CODE * rng.uniform(-1, 1, indices.size) ** 3)[:, None], 3, axis=1)
    codes[::3] = coded(LARGEST_CODE * rng.uniform(-1, 1, (len(codes[::3]), 3)) ** 3)
    codes[::5] *= np.eye(3, dtype=np.int32)[rng.integers(0, 3, len(codes[::5]))]
    colours = rng.integers(0, 3, rows) << 30 | rng.integers(60, 64, rows) << 24 | rng.integers(1 << 20, 1 << 24, rows)
    trust = rng.choice([0, 400, FULL_TRUST], rows).astype(np.int16) if trusted else None
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    scale = 2.0 ** -np.ceil(np.log2(LARGEST_CODE))
    return SmallMap(indptr, indices, codes, output, source, colours.astype(np.uint32), trust, scale)


def with_words(room: Room, max_error: float = 0.5) -> Room:
    """The room with its maps in words, as a build stores them."""
    return replace(room, maps=replace(room.maps, words=words_of(room.maps, max_error)))


def as_long(maps: RoomMaps) -> RoomMaps:
    """The values of the words in maps of 16 bytes per entry, for the CPU function."""
    assert maps.refinement is not None
    assert maps.words is not None
    small = {name: made.unpacked() for name, made in maps.words.maps.items()}
    far, refinement = maps.far, maps.refinement
    seen = small["transport"]
    if far is None or refinement.far_dual is None:
        dual = _undone(small["dual"], seen.gain)
        return replace(maps, transport=_packed(seen), refinement=replace(refinement, dual=dual))
    parts = {name: small[f"far_{name}"] for name in vars(far)}
    duals = {name: small[f"dual_{name}"] for name in vars(refinement.far_dual)}
    gain = parts["scatter"].gain
    dual = _undone(small["dual"], gain)
    far_dual = replace(
        refinement.far_dual,
        gather=_undone(duals["gather"], gain),
        mix=_packed(duals["mix"]),
        scatter=_packed(duals["scatter"]),
    )
    return replace(
        maps,
        transport=_packed(seen),
        far=replace(far, **{name: _packed(part) for name, part in parts.items()}),
        refinement=replace(refinement, dual=dual, far_dual=far_dual),
    )


def _packed(small: SmallMap) -> RowMap:
    return pack(small.unpacked(), small.output_shape, small.source_shape)


def _undone(small: SmallMap, gain: np.ndarray) -> RowMap:
    """Row map that multiplies the plain picture, not the picture weighted by `gain`."""
    rows: SparseRows = small.unpacked()
    rows = replace(rows, weights=rows.weights * gain.reshape(-1, 3)[rows.indices])
    return pack(rows, small.output_shape, small.source_shape)
