"""Compiled conversion of a matrix's codes to runs of words; small_map.py describes the format."""

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.products import kept
from counterlight.maps.small_map import (
    ALL,
    FARTHEST_STEP,
    FRACTION_BITS,
    FULL_TRUST,
    JUMP,
    MOST_SHIFT,
    THREE,
    TRUST,
    IntArray,
    SmallMap,
    Words,
)


def in_words(small: SmallMap) -> Words:
    """Return each row as a run of words, starting from source pixel 0.

    If a row's trust is between 0 and 1, the run begins with a word for the trust.
    """
    trust = np.zeros(small.indptr.size - 1, np.int16) if small.trust is None else small.trust
    said = (trust > 0) & (trust < FULL_TRUST)
    starts = np.concatenate([[0], np.cumsum(_run_lengths(small.indptr, small.indices, small.codes, said))])
    words = np.empty(starts[-1], np.uint32)
    _write_runs(small.indptr, small.indices, small.codes, trust, said, starts, words)
    return Words(words, starts)


@kept()
def _kind(code: NDArray[np.int32]) -> int:
    if code[0] == code[1] and code[1] == code[2]:
        return ALL
    lit = int(code[0] != 0) | int(code[1] != 0) << 1 | int(code[2] != 0) << 2
    return THREE if lit in (0, 3, 5, 6, 7) else lit


@kept()
def _bits(code: int) -> int:
    """Return the 16 bits of a code."""
    size, shift = abs(code), 0
    while size >> shift >= 2 << FRACTION_BITS and shift < MOST_SHIFT:
        shift += 1
    number = size >> shift
    exponent = shift + 1 if number >> FRACTION_BITS else 0
    return int(code < 0) << 15 | exponent << FRACTION_BITS | number & ((1 << FRACTION_BITS) - 1)


@kept()
def _run_lengths(
    indptr: IntArray, indices: NDArray[np.int32], codes: NDArray[np.int32], said: NDArray[np.bool_]
) -> IntArray:
    """Return the number of words of each row, (rows,). said : (rows,) bool. Whether a row has a word for trust."""
    lengths = said.astype(np.int64)
    for row in range(lengths.size):
        before = 0
        for k in range(indptr[row], indptr[row + 1]):
            lengths[row] += 1 + (indices[k] - before > FARTHEST_STEP) + (_kind(codes[k]) == THREE)
            before = indices[k]
    return lengths


@kept()
def _write_runs(
    indptr: IntArray,
    indices: NDArray[np.int32],
    codes: NDArray[np.int32],
    trust: NDArray[np.int16],
    said: NDArray[np.bool_],
    starts: IntArray,
    words: NDArray[np.uint32],
) -> None:
    """Fill `words`, row r from starts[r] on. trust : (rows,), read where `said`."""
    for row in range(said.size):
        at, before = starts[row], np.int64(0)
        if said[row]:
            words[at] = TRUST | np.int64(trust[row]) << 16
            at += 1
        for k in range(indptr[row], indptr[row + 1]):
            distance, kind = np.int64(indices[k]) - before, _kind(codes[k])
            before = np.int64(indices[k])
            if distance > FARTHEST_STEP:
                words[at] = JUMP | distance << 3
                at, distance = at + 1, np.int64(0)
            channel = 1 if kind == 2 else 2 if kind == 4 else 0
            words[at] = kind | distance << 3 | np.int64(_bits(codes[k, channel])) << 16
            at += 1
            if kind == THREE:
                words[at] = _bits(codes[k, 1]) | np.int64(_bits(codes[k, 2])) << 16
                at += 1
