"""Fits colours and codes of a matrix in words, so that no result changes by more than allowed (maps/small_map.py).

Most rows have one colour, the colour of their sum; one code for all channels is then exact except for rounding. For
other rows, the colour is the weighted median of the entries' colours. Entries then get one code per channel, those with
the largest effect first, until the change is allowed.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.maps.products import LARGE, compiled, kept
from counterlight.maps.row_map import SparseRows
from counterlight.maps.small_map import FRACTION_BITS, FULL, HIGHEST, LARGEST_CODE, MOST_SHIFT

LEVEL = 8  # a channel's largest code may be at most this many times another channel's largest code

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Fit:
    """The fitted words.

    scale : as in SmallMap.
    colours : (rows,) uint32, as in SmallMap.
    codes : (entries, 3) int32, as in SmallMap.
    change : (rows, 3). Largest error of a row's product with a source of 0..reach.
    """

    scale: float
    colours: NDArray[np.uint32]
    codes: NDArray[np.int32]
    change: FloatArray


def scale_of(largest: float) -> float:
    """Return the scale of codes for weights up to `largest`; a colour's shares are at least 1/FULL."""
    return float(2.0 ** np.ceil(np.log2(FULL * largest / LARGEST_CODE))) if largest > 0 else 1.0


def fit(rows: SparseRows, reach: FloatArray, allowed: FloatArray, scale: float | None = None) -> Fit:
    """Fit colours and codes of a matrix.

    reach : (columns, 3). Largest source values.
    allowed : (rows, 3). Allowed error of a product; `change` is larger if codes of 16 bits cannot keep it.
    scale : from `scale_of`, shared with further rows; None for these rows alone.
    """
    if scale is None:
        scale = scale_of(max(float(rows.weights.max(initial=0.0)), -float(rows.weights.min(initial=0.0))))
    colours, codes = np.empty(rows.shape[0], np.uint32), np.empty((rows.indices.size, 3), np.int32)
    change, limits = np.zeros((rows.shape[0], 3)), np.asarray(allowed / scale, np.float64)
    indptr, indices = rows.indptr.astype(np.int64), rows.indices.astype(np.int32)
    reach = np.asarray(reach, np.float64)
    _FIT_ROWS[indices.size >= LARGE](indptr, indices, rows.weights, scale, reach, limits, colours, codes, change)
    return Fit(scale, colours, codes, change * scale)


@kept()
def _coded(value: float) -> int:
    """Return the nearest code, as `small_map.coded` does."""
    value = min(max(value, -LARGEST_CODE), LARGEST_CODE)
    shift = min(max(math.frexp(value)[1] - FRACTION_BITS - 1, 0), MOST_SHIFT)
    unit = float(1 << shift)
    return int(np.rint(value / unit) * unit)


@kept()
def _colour(bits: np.uint32) -> FloatArray:
    """Decode a colour, as `small_map.colours_of` does."""
    number = np.int64(bits)
    largest, size = number >> 30, 2.0 ** ((number >> 24 & HIGHEST) - HIGHEST)
    colour = np.full(3, size)
    for after, shift in ((1, 12), (2, 0)):
        colour[(largest + after) % 3] = size * np.float64(np.float32(number >> shift & FULL) / np.float32(FULL))
    return colour


@kept()
def _colour_bits(colour: FloatArray, weights: FloatArray) -> int:
    """Encode a colour in 32 bits, scaled so that no code exceeds LARGEST_CODE."""
    largest = 0
    for k in (1, 2):
        if colour[k] > colour[largest]:
            largest = k
    bits = largest << 30
    for after, shift in ((1, 12), (2, 0)):
        share = colour[(largest + after) % 3] / colour[largest] if colour[largest] > 0 else 1.0
        bits |= min(max(int(np.rint(FULL * share)), 1), FULL) << shift
    plain, needed = _colour(np.uint32(bits | HIGHEST << 24)), 0.0
    for i in range(len(weights)):
        for k in range(3):
            needed = max(needed, abs(weights[i, k]) / plain[k])
    exponent = math.ceil(math.log2(needed / LARGEST_CODE)) if needed > 0 else 0
    return bits | min(max(exponent + HIGHEST, 0), HIGHEST) << 24


@kept()
def _one_code_each(weights: FloatArray, colour: FloatArray, codes: NDArray[np.int32]) -> None:
    """Give each entry one code for all channels: the median of the three channels' codes."""
    for i in range(len(weights)):
        a, b, c = weights[i, 0] / colour[0], weights[i, 1] / colour[1], weights[i, 2] / colour[2]
        code = _coded(max(min(a, b), min(max(a, b), c)))
        for k in range(3):
            codes[i, k] = code


@kept()
def _too_much_and_too_little(
    weights: FloatArray, reach: FloatArray, colour: FloatArray, codes: NDArray[np.int32]
) -> FloatArray:
    """Return the largest positive and negative error of a row's product, (2, 3)."""
    found = np.zeros((2, 3))
    for i in range(len(weights)):
        for k in range(3):
            off = (codes[i, k] * colour[k] - weights[i, k]) * reach[i, k]
            found[0, k] += max(off, 0.0)
            found[1, k] -= min(off, 0.0)
    return found


@kept()
def _beyond(change: FloatArray, allowed: FloatArray) -> bool:
    """Return whether any error, (2, 3), exceeds the allowed one, (3,)."""
    beyond = False
    for k in range(3):
        beyond |= change[0, k] > allowed[k] or change[1, k] > allowed[k]
    return beyond


@kept()
def _median_colour(weights: FloatArray, reach: FloatArray) -> FloatArray:
    """Return the median of the entries' colours, weighted by the entries' light."""
    count = len(weights)
    own, heavy, shares, colour = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(3)
    for i in range(count):
        for k in range(3):
            own[i] += abs(weights[i, k])
            heavy[i] += abs(weights[i, k]) * reach[i, k]
    for k in range(3):
        for i in range(count):
            shares[i] = weights[i, k] / max(own[i], 1e-300) if own[i] > 0 else 0.0
        order = np.argsort(shares)
        total = 0.0
        for i in order:
            total += heavy[i]
        passed, middle = 0.0, 0
        for i in order:
            passed, middle = passed + heavy[i], i
            if passed >= 0.5 * total * (1 - 1e-9):
                break
        colour[k] = max(shares[middle], 0.0)
    return colour


@kept()
def _levelled(colour: FloatArray, weights: FloatArray) -> FloatArray:
    """Raise channels whose codes would be much larger than another channel's, because all share one scale."""
    largest, finest = np.zeros(3), np.inf
    for k in range(3):
        for i in range(len(weights)):
            largest[k] = max(largest[k], abs(weights[i, k]))
        if largest[k] > 0 and colour[k] > 0:
            finest = min(finest, largest[k] / colour[k])
    if finest < np.inf:
        for k in range(3):
            largest[k] = max(colour[k], largest[k] / (LEVEL * finest))
    return largest


@kept()
def _as_many_as_needed(
    weights: FloatArray, reach: FloatArray, colour: FloatArray, allowed: FloatArray, codes: NDArray[np.int32]
) -> None:
    """Give one code to as many entries as the allowed change permits; the entries with the largest effect get three."""
    one = np.empty_like(codes)
    _one_code_each(weights, colour, one)
    worst = np.zeros(len(weights))
    for i in range(len(weights)):
        for k in range(3):
            codes[i, k] = _coded(weights[i, k] / colour[k])
            worst[i] = max(worst[i], abs(one[i, k] * colour[k] - weights[i, k]) * reach[i, k] / allowed[k])
    change = _too_much_and_too_little(weights, reach, colour, codes)
    for i in np.argsort(worst):
        for k in range(3):
            before, after = codes[i, k] * colour[k] - weights[i, k], one[i, k] * colour[k] - weights[i, k]
            change[0, k] += (max(after, 0.0) - max(before, 0.0)) * reach[i, k]
            change[1, k] -= (min(after, 0.0) - min(before, 0.0)) * reach[i, k]
        if _beyond(change, allowed):
            break
        for k in range(3):
            codes[i, k] = one[i, k]


@kept()
def _fit_row(
    indices: NDArray[np.int32],
    weights: NDArray[np.floating],
    scale: float,
    reach: FloatArray,
    allowed: FloatArray,
    codes: NDArray[np.int32],
    change: FloatArray,
) -> int:
    """Fit the codes and the change of one row; returns its colour. allowed, change : divided by the scale.

    Explicit loops: Numba takes half a minute to compile array sums and slices.
    """
    light, at, total = np.empty((indices.size, 3)), np.empty((indices.size, 3)), np.zeros(3)
    for i in range(indices.size):
        for k in range(3):
            light[i, k], at[i, k] = np.float64(weights[i, k]) / scale, reach[indices[i], k]
            total[k] += light[i, k] * at[i, k]
    bits: int = _colour_bits(total, light)
    colour = _colour(np.uint32(bits))
    _one_code_each(light, colour, codes)
    found = _too_much_and_too_little(light, at, colour, codes)
    if _beyond(found, allowed):
        bits = _colour_bits(_levelled(_median_colour(light, at), light), light)
        colour = _colour(np.uint32(bits))
        _as_many_as_needed(light, at, colour, allowed, codes)
        found = _too_much_and_too_little(light, at, colour, codes)
    for k in range(3):
        change[k] = max(found[0, k], found[1, k])  # a source may produce either error alone
    return bits


def _fit_rows(
    indptr: IntArray,
    indices: NDArray[np.int32],
    weights: NDArray[np.floating],
    scale: float,
    reach: FloatArray,
    allowed: FloatArray,
    colours: NDArray[np.uint32],
    codes: NDArray[np.int32],
    change: FloatArray,
) -> None:
    """Fit colours, codes and change of all rows. allowed, change : divided by the scale."""
    for row in numba.prange(indptr.size - 1):
        own = slice(indptr[row], indptr[row + 1])
        colours[row] = _fit_row(indices[own], weights[own], scale, reach, allowed[row], codes[own], change[row])


_FIT_ROWS = compiled(_fit_rows)
