"""The colours and codes of a matrix in small words, so that no result changes by more than is allowed (small_map.py).

Most rows have one colour, that of their sum: codes of one number for all channels are exact but for rounding. Of the
others, a row's colour is the weighted median of its entries' colours, which is that of most of them, and entries get a
code for each channel, those first that change the result most, until the change is allowed. Numpy alone: a compiler
would take longer than the room to open.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.maps.small_map import FULL, HIGHEST, LARGEST_CODE, coded, colours_of

LEVEL = 8  # times as large as another channel's that the largest code of a channel may be

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Fit:
    """scale, colours, (rows,) uint32, codes, (entries, 3) int32 : as SmallMap has them.

    change : (rows, 3), the most by which a row's product with a source of 0..reach is off.
    """

    scale: float
    colours: NDArray[np.uint32]
    codes: NDArray[np.int32]
    change: FloatArray


def fit(rows: SparseRows, reach: FloatArray, allowed: FloatArray) -> Fit:
    """Colours and codes of a matrix.

    reach : (columns, 3), the most that the source holds.  allowed : (rows, 3), how far a product may be off; where
    codes of 16 bits cannot keep it, `change` is larger.
    """
    count, owner, weights = rows.shape[0], rows.rows, rows.weights.astype(np.float64)
    largest = float(np.abs(weights).max(initial=0.0))
    scale = 2.0 ** np.ceil(np.log2(FULL * largest / LARGEST_CODE)) if largest > 0 else 1.0  # shares are 1/FULL and more
    weights /= scale
    reach, allowed = reach.astype(np.float64), allowed / scale
    colours = _colour_bits(_sums(weights * reach[rows.indices], owner, count), weights, owner)
    codes, change = _coded(weights, reach[rows.indices], owner, colours, three=False)
    left = np.maximum(*_signed_sums(change, owner, count))
    several = np.flatnonzero((left > allowed).any(axis=1))
    if several.size:
        chosen = np.zeros(count, bool)
        chosen[several] = True
        where = np.flatnonzero(chosen[owner])
        indptr = np.concatenate([[0], np.cumsum(rows.lengths[several])])
        part = SparseRows(indptr, rows.indices[where], weights[where], rows.columns)
        colours[several], codes[where], left[several] = _of_several_colours(part, reach, allowed[several])
    return Fit(scale, colours, codes, left * scale)


def _of_several_colours(
    rows: SparseRows, reach: FloatArray, allowed: FloatArray
) -> tuple[NDArray[np.uint32], NDArray[np.int32], FloatArray]:
    """Colours, codes and change; weights over the scale."""
    count, owner, weights, at = rows.shape[0], rows.rows, np.asarray(rows.weights), reach[rows.indices]
    colours = _colour_bits(_median_colours(weights, weights * at, owner, count), weights, owner)
    one, change = _coded(weights, at, owner, colours, three=False)
    three, changed = _coded(weights, at, owner, colours, three=True)
    worst = (np.abs(change) / allowed[owner]).max(axis=1)
    order = np.lexsort((-worst, owner))
    wide = np.empty(owner.size, bool)
    wide[order] = _must_change(change[order], changed[order], owner[order], allowed, rows.indptr)
    codes, final = np.where(wide[:, None], three, one), np.where(wide[:, None], changed, change)
    return colours, codes, np.maximum(*_signed_sums(final, owner, count))


def _must_change(
    before: FloatArray, after: FloatArray, owner: IntArray, allowed: FloatArray, indptr: NDArray[np.integer]
) -> NDArray[np.bool_]:
    """Which entries get three codes, the first ones of each row: (entries,).

    before, after : (entries, 3), what an entry changes with one code and with three, those of a row in the order in
    which they get them.
    """
    needed = np.zeros(owner.size, bool)
    for sign in (1.0, -1.0):
        one, three = np.maximum(sign * before, 0), np.maximum(sign * after, 0)
        still = _from_here(one, owner, indptr) + _before_here(three, owner, indptr)
        needed |= (still > allowed[owner]).any(axis=1)
    last = np.where(needed, np.arange(owner.size), -1)
    last_of_row = np.full(allowed.shape[0], -1)
    np.maximum.at(last_of_row, owner, last)
    return np.arange(owner.size) <= last_of_row[owner]


def _before_here(values: FloatArray, owner: IntArray, indptr: NDArray[np.integer]) -> FloatArray:
    """Sums over the entries of a row before each."""
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    return np.asarray(sums[:-1] - sums[indptr[owner]])


def _from_here(values: FloatArray, owner: IntArray, indptr: NDArray[np.integer]) -> FloatArray:
    """Sums over each entry and those of its row behind it."""
    sums = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    return np.asarray(sums[indptr[owner + 1]] - sums[:-1])


def _coded(
    weights: FloatArray, reach: FloatArray, owner: IntArray, colours: NDArray[np.uint32], *, three: bool
) -> tuple[NDArray[np.int32], FloatArray]:
    """Codes of one number for all channels, or of three, and what they change, (entries, 3)."""
    colour = colours_of(colours).astype(np.float64)[owner]
    quotients = weights / colour
    if not three:
        quotients = np.broadcast_to(_middle(quotients)[:, None], weights.shape)
    codes = coded(quotients)
    return codes, (codes * colour - weights) * reach


def _middle(values: FloatArray) -> FloatArray:
    """The median of three."""
    a, b, c = values.T
    return np.asarray(np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c)))


def _sums(values: FloatArray, owner: IntArray, count: int) -> FloatArray:
    """(entries, 3) -> (rows, 3)."""
    return np.stack([np.bincount(owner, values[:, k], count) for k in range(3)], axis=1)


def _signed_sums(change: FloatArray, owner: IntArray, count: int) -> tuple[FloatArray, FloatArray]:
    """What is too much and what is too little, (rows, 3) each: a source may hold either alone."""
    return _sums(np.maximum(change, 0), owner, count), _sums(np.maximum(-change, 0), owner, count)


def _median_colours(weights: FloatArray, light: FloatArray, owner: IntArray, count: int) -> FloatArray:
    """Of each channel's share of an entry, the median by the entries' light, (rows, 3)."""
    own, heavy = np.abs(weights).sum(axis=1), np.abs(light).sum(axis=1)
    half, result = 0.5 * np.bincount(owner, heavy, count), np.zeros((count, 3))
    for k in range(3):
        shares = np.divide(weights[:, k], own, out=np.zeros_like(own), where=own > 0)
        order = np.lexsort((shares, owner))
        passed = np.cumsum(heavy[order])
        row_start = np.concatenate([[0.0], passed])[np.searchsorted(owner, np.arange(count))]
        reached = np.flatnonzero(passed - row_start[owner] >= half[owner] * (1 - 1e-9))
        first = reached[np.concatenate([[True], np.diff(owner[reached]) > 0])]
        result[owner[first], k] = np.maximum(shares[order[first]], 0)
    return _levelled(result, weights, owner)


def _levelled(colours: FloatArray, weights: FloatArray, owner: IntArray) -> FloatArray:
    """Channels raised where codes would be much larger than another's: they share one scale, (rows, 3)."""
    largest = np.zeros_like(colours)
    np.maximum.at(largest, owner, np.abs(weights))
    codes = np.divide(largest, colours, out=np.full_like(colours, np.inf), where=colours > 0)
    finest = np.min(np.where(largest > 0, codes, np.inf), axis=1, keepdims=True)
    return np.where(np.isfinite(finest), np.maximum(colours, largest / (LEVEL * finest)), largest)


def _colour_bits(colour: FloatArray, weights: FloatArray, owner: IntArray) -> NDArray[np.uint32]:
    """Colours (rows, 3) in 32 bits, so scaled that no code is beyond LARGEST_CODE."""
    count, largest = colour.shape[0], np.argmax(colour, axis=1)
    most = np.take_along_axis(colour, largest[:, None], axis=1)
    shares = np.divide(colour, most, out=np.ones_like(colour), where=most > 0)
    parts = np.clip(np.rint(FULL * shares), 1, FULL).astype(np.int64)
    rows = np.arange(count)
    bits = largest << 30 | parts[rows, (largest + 1) % 3] << 12 | parts[rows, (largest + 2) % 3]
    plain = colours_of((bits | HIGHEST << 24).astype(np.uint32)).astype(np.float64)
    needed = np.zeros(count)
    np.maximum.at(needed, owner, (np.abs(weights) / plain[owner]).max(axis=1))
    with np.errstate(divide="ignore"):
        exponent = np.where(needed > 0, np.ceil(np.log2(needed / LARGEST_CODE)), 0.0)
    return np.asarray(bits | np.clip(exponent + HIGHEST, 0, HIGHEST).astype(np.int64) << 24, np.uint32)
