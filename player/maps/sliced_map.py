"""A map's entries or words in the order in which a compute shader's workgroups read them (sliced ELLPACK, sorted rows).

Rows are binned by length, eight bins per doubling; within a bin they follow in tiles of 8×8 pixels. The invocations of
a workgroup therefore take about equally long, and read neighbouring source pixels. A workgroup's entries are
interleaved, so that its invocations read one contiguous stretch at a time (Kreutzer et al. 2014, SELL-C-σ). If there
are few rows, several invocations (`lanes`) share a row.

In words, a row's entries are dealt to its lanes in turn; each lane is a separate run. The runs of a workgroup are
interleaved and padded with empty words. Uses no OpenGL; shaders/row_map.comp and small_map.comp read the results.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.row_map import RowMap, UintArray
from counterlight.maps.small_map import FULL_TRUST, SmallMap, Words
from counterlight.maps.word_map import WordMap

GROUP = 64  # invocations of a workgroup
BINS = 8  # bins of rows per doubling of the row length
TILE = 8
ENOUGH = 1 << 16  # invocations that are enough to keep a GPU busy
MOST_GROUPS = 65535  # most workgroups per dispatch that OpenGL guarantees
NO_PIXEL = 0xFFFFFFFF

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Part:
    """The input of one dispatch of the compute shader.

    rows : (rows, 4) uint32. Output pixel x | y << 16 (NO_PIXEL for padding), the number 0, length, first entry. A row's
        k-th entry is entry `first + k // lanes · GROUP + k % lanes`.
    entries : (entries, 4) uint32. Bits of three float32 weights, source x | y << 16.
    """

    rows: UintArray
    entries: UintArray


def lanes_of(packed: RowMap) -> int:
    """Return the invocations per row: more than one for few rows with many entries."""
    return lanes_for(packed.lookup.shape[0] * packed.lookup.shape[1], packed.count)


def lanes_for(rows: int, entries: int) -> int:
    """Return the invocations per row, given the numbers of rows and entries."""
    mean, lanes = entries / rows, 1
    while lanes < GROUP and rows * lanes < ENOUGH and 2 * lanes <= mean:
        lanes *= 2
    return lanes


def parts(packed: RowMap, lanes: int, most_entries: int) -> Iterator[Part]:
    """Yield the map in parts of at most `most_entries`, padding included; a workgroup is never split."""
    shape, starts, lengths = _rows(packed)
    order = row_order(lengths, shape)
    a_group = GROUP // lanes
    padded = np.concatenate([order, np.full(-order.size % a_group, -1)]).reshape(-1, a_group)
    longest = np.where(padded >= 0, lengths[padded], 0).max(axis=1)
    sizes = -(-longest // lanes) * GROUP
    for groups in cut(sizes, max(most_entries, int(sizes.max()))):
        yield _part(packed, padded[groups], sizes[groups], lanes, (shape[1], starts, lengths))


def row_order(lengths: IntArray, shape: tuple[int, int]) -> IntArray:
    """Return output pixels, longest rows first; within a bin, tile by tile.

    lengths : (pixels,).
    shape : (height, width).
    """
    bins = np.where(lengths > 0, np.floor(BINS * np.log2(np.maximum(lengths, 1))), -1)
    y, x = np.divmod(np.arange(lengths.size), shape[1])
    return np.lexsort((x % TILE, y % TILE, x // TILE, y // TILE, -bins))


def cut(sizes: IntArray, most: int) -> Iterator[slice]:
    """Yield slices of consecutive workgroups with at most `most` entries, and at most MOST_GROUPS workgroups."""
    ends, first = np.cumsum(sizes), 0
    while first < sizes.size:
        before = ends[first] - sizes[first]
        last = min(int(np.searchsorted(ends, before + most, side="right")), first + MOST_GROUPS)
        yield slice(first, last)
        first = last


def _part(
    packed: RowMap,
    groups: IntArray,
    sizes: IntArray,
    lanes: int,
    places: tuple[int, IntArray, IntArray],
) -> Part:
    width, starts, lengths = places
    pixels = groups.ravel()
    here = np.where(pixels >= 0, lengths[pixels], 0)
    before = np.cumsum(sizes) - sizes
    first = (before[:, None] + lanes * np.arange(groups.shape[1])).ravel()
    run, texels = _runs(starts[pixels], here)
    k = np.arange(texels.size) - np.repeat(run, here)
    to = np.repeat(first, here) + k // lanes * GROUP + k % lanes
    x, y = _source(packed, texels)
    weights = packed.entries.reshape(-1, 4)[texels, :3]
    entries = np.zeros((int(sizes.sum()), 4), np.uint32)
    entries[to, :3], entries[to, 3] = weights.view(np.uint32), x | y << 16
    at = np.where(pixels >= 0, pixels % width | pixels // width << 16, NO_PIXEL)
    return Part(np.stack([at, np.zeros_like(at), here, first], axis=1).astype(np.uint32), entries)


def _rows(packed: RowMap) -> tuple[tuple[int, int], IntArray, IntArray]:
    """Return the output shape, and each row's first texel and length."""
    x, y, lengths = (packed.lookup[..., i].ravel().astype(np.int64) for i in range(3))
    return packed.output_shape, y * packed.entries.shape[1] + x, lengths


def _runs(starts: IntArray, lengths: IntArray) -> tuple[IntArray, IntArray]:
    """Return the index at which each row begins in a list of all rows' texels, and the list."""
    first = np.cumsum(lengths) - lengths
    return first, np.repeat(starts - first, lengths) + np.arange(int(lengths.sum()))


def _source(packed: RowMap, texels: IntArray) -> tuple[IntArray, IntArray]:
    """Return x and y of the source pixels."""
    index = packed.entries[..., 3] if packed.index is None else packed.index
    y, x = np.divmod(index.ravel()[texels].astype(np.int64), packed.source_shape[1])
    return x, y


@dataclass(frozen=True)
class WordPart:
    """The input of one dispatch of the compute shader.

    rows : (rows, 1 or 2) uint32. Output pixel x | y << 16 (NO_PIXEL for padding), and the colour if the map has
        colours.
    groups : (workgroups, 2) uint32. First word, words per run.
    words : (words,) uint32. Run r's k-th word is `first + k · GROUP + r % GROUP`.
    """

    rows: UintArray
    groups: UintArray
    words: UintArray


def lanes_of_words(small: WordMap) -> int:
    return lanes_for(small.output_shape[0] * small.output_shape[1], small.runs.words.size)


def word_parts(small: WordMap, lanes: int, most_words: int) -> Iterator[WordPart]:
    """Yield the map in parts of at most `most_words`, padding included; a workgroup is never split."""
    # imported only when needed, because importing Numba takes half a second
    from counterlight.maps.word_runs import in_words

    runs = small.runs
    order = row_order(np.diff(runs.starts), small.output_shape)
    pixels = np.concatenate([order, np.full(-order.size % (GROUP // lanes), -1)])
    there = pixels >= 0
    made = _chosen(runs, pixels) if lanes == 1 else in_words(_lanes(small.unpacked(), pixels, lanes))
    lengths = np.diff(made.starts).reshape(-1, GROUP)
    longest = lengths.max(axis=1)
    width = small.output_shape[1]
    at = np.where(there, pixels % width | pixels // width << 16, NO_PIXEL)
    columns = [at] if small.colours is None else [at, np.where(there, small.colours[pixels], 0)]
    rows = np.stack(columns, axis=1).astype(np.uint32)
    for groups in cut(longest * GROUP, max(most_words, int(longest.max()) * GROUP)):
        first_row, last_row = groups.start * GROUP // lanes, groups.stop * GROUP // lanes
        first_run, last_run = groups.start * GROUP, groups.stop * GROUP
        bases = (np.cumsum(longest[groups]) - longest[groups]) * GROUP
        words = np.zeros(int(longest[groups].sum()) * GROUP, np.uint32)
        own = lengths[groups].ravel()
        k = np.arange(own.sum()) - np.repeat(np.cumsum(own) - own, own)
        lane = np.repeat(np.arange(own.size), own)
        words[bases[lane // GROUP] + k * GROUP + lane % GROUP] = made.words[
            made.starts[first_run] : made.starts[last_run]
        ]
        described = np.stack([bases, longest[groups]], axis=1).astype(np.uint32)
        yield WordPart(rows[first_row:last_row], described, words)


def _chosen(runs: Words, pixels: IntArray) -> Words:
    """Return the runs of some rows; an empty run for -1."""
    lengths = np.where(pixels >= 0, np.diff(runs.starts)[pixels], 0)
    starts = np.concatenate([[0], np.cumsum(lengths)])
    at = np.repeat(runs.starts[pixels] - starts[:-1], lengths) + np.arange(starts[-1])
    return Words(runs.words[at], starts)


def _lanes(small: SmallMap, pixels: IntArray, lanes: int) -> SmallMap:
    """Return the rows of some pixels, empty for -1, split into `lanes` runs each: (pixels · lanes) rows."""
    lengths = np.where(pixels >= 0, np.diff(small.indptr)[pixels], 0)
    row = np.repeat(np.arange(pixels.size), lengths)
    k = np.arange(row.size) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    run = row * lanes + k % lanes
    order = np.argsort(run, kind="stable")
    entries = (small.indptr[pixels][row] + k)[order]
    indptr = np.concatenate([[0], np.cumsum(np.bincount(run, minlength=pixels.size * lanes))])
    trust = None
    if small.trust is not None:
        trust = np.full(pixels.size * lanes, FULL_TRUST, np.int16)
        trust[::lanes] = np.where(pixels >= 0, small.trust[pixels], FULL_TRUST)
    return replace(small, indptr=indptr, indices=small.indices[entries], codes=small.codes[entries], trust=trust)
