"""A small map's words in the order in which a compute shader's workgroups read them; see sliced_map.py.

A row's entries are dealt to its lanes in turn; each lane is a separate run. The runs of a workgroup are interleaved and
padded with empty words. Uses no OpenGL; shaders/small_map.comp reads the result.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from counterlight.maps.row_map import UintArray
from counterlight.maps.sliced_map import GROUP, NO_PIXEL, IntArray, cut, lanes_for, row_order
from counterlight.maps.small_map import FULL_TRUST, SmallMap, Words
from counterlight.maps.word_map import WordMap


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
    from counterlight.maps.word_runs import in_words  # importing Numba takes half a second, so only when needed

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
