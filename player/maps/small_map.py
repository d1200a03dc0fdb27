"""A sparse matrix in words of 4 bytes: T ≈ diag(C) W, with one picture of colours C, and integer weights.

Each entry in a row of T is nearly a weight times the camera pixel's colour: T_k[i,j] = C_k(i) · code_k[i,j]. Most codes
are equal for red, green and blue and then take one word, as does a code of a single channel; three different codes take
two words. The transpose has the same codes, and its source is the picture times C. T and Tᵀ in words are therefore
exact transposes of each other, and colours are stored once. tools/inverse/words_fit.py chooses colours and codes.

A row is a run of words. From the lowest bit: 3 bits for the kind, 13 for the distance from the previous source pixel,
16 for the code. The code is a small float, so that small and large weights have the same relative precision: fraction
(12 bits), exponent (3), sign. It stands for integers below 2¹², then for (2¹² + fraction) 2^(exponent − 1). Other
kinds: JUMP has 29 bits of distance. THREE holds the red code, and the next word is green | blue << 16. TRUST holds the
row's weight in refinement in its upper 16 bits. shaders/small_words.glsl reads the words.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.row_map import SparseRows

JUMP, THREE, TRUST, ALL = 0, 3, 5, 7  # kinds of words; kinds 1, 2 and 4 hold a code of red, green or blue alone
OTHERS = -1  # the word after a THREE, which holds green and blue
FRACTION_BITS, MOST_SHIFT = 12, 6
LARGEST_CODE = ((2 << FRACTION_BITS) - 1) << MOST_SHIFT
FULL_TRUST = 32767
FARTHEST_STEP, FARTHEST_JUMP = (1 << 13) - 1, (1 << 29) - 1
FULL, HIGHEST = 4095, 63  # largest value of a colour's channel, and largest exponent of a colour
WORD_BYTES = 4

IntArray = NDArray[np.int64]
Uint32 = NDArray[np.uint32]


@dataclass(frozen=True)
class SmallMap:
    """out_i = scale · C(i) ∘ Σ_j code[i,j] ∘ source_j.

    indptr : (rows + 1,).
    indices : (entries,), ascending in each row.
    codes : (entries, 3) int32. Integers that a word can hold.
    colours : (rows,) uint32. C in the format of `colours_of`; None for 1.
    trust : (rows,). w of a weighted product, w C ∘ (base − out), in units of 1 / FULL_TRUST.
    """

    indptr: IntArray
    indices: NDArray[np.int32]
    codes: NDArray[np.int32]
    output_shape: tuple[int, int]
    source_shape: tuple[int, int]
    colours: Uint32 | None = None
    trust: NDArray[np.int16] | None = None
    scale: float = 1.0

    @property
    def count(self) -> int:
        return self.indices.size

    @property
    def most_words(self) -> int:
        """Upper bound of the number of words: three per entry, and one per row."""
        return 3 * self.count + self.indptr.size

    @property
    def rows(self) -> IntArray:
        """The row of each entry, (entries,)."""
        return np.repeat(np.arange(self.indptr.size - 1), np.diff(self.indptr))

    @property
    def gain(self) -> NDArray[np.float32]:
        """w C, (output height, output width, 3)."""
        gain = np.ones((self.indptr.size - 1, 3), np.float32)
        if self.colours is not None:
            gain *= colours_of(self.colours)
        if self.trust is not None:
            gain *= (self.trust / np.float32(FULL_TRUST))[:, None]
        return gain.reshape(*self.output_shape, 3)

    def transposed(self, kept: NDArray[np.bool_] | None, colours: Uint32 | None) -> "SmallMap":
        """Return the codes' transpose, using only the rows in `kept`. colours : colours of the transpose's rows."""
        # imported only when needed, because importing Numba takes half a second
        from counterlight.maps.products import transpose

        own = self if kept is None else self.where(np.repeat(kept, np.diff(self.indptr)))
        columns = self.source_shape[0] * self.source_shape[1]
        indptr, indices, codes = transpose(own.indptr, own.indices, own.codes, columns)
        return SmallMap(indptr, indices, codes, self.source_shape, self.output_shape, colours, scale=self.scale)

    def where(self, keep: NDArray[np.bool_]) -> "SmallMap":
        """Keep only some entries. keep : (entries,) bool."""
        if keep.all():
            return self
        kept_before = np.concatenate([[0], np.cumsum(keep)])
        return replace(self, indptr=kept_before[self.indptr], indices=self.indices[keep], codes=self.codes[keep])

    def of_rows(self, first: int, last: int) -> "SmallMap":
        """Return consecutive rows as a picture of one line."""
        start, end = int(self.indptr[first]), int(self.indptr[last])
        return SmallMap(
            self.indptr[first : last + 1] - start,
            self.indices[start:end],
            self.codes[start:end],
            (1, last - first),
            self.source_shape,
            None if self.colours is None else self.colours[first:last],
            None if self.trust is None else self.trust[first:last],
            self.scale,
        )

    def unpacked(self) -> SparseRows:
        """Return the matrix with float64 weights."""
        weights = self.codes * self.scale
        if self.colours is not None:
            weights = weights * colours_of(self.colours)[self.rows].astype(np.float64)
        return SparseRows(self.indptr, self.indices, weights, self.source_shape[0] * self.source_shape[1])


@dataclass(frozen=True)
class Words:
    """Runs of words: run r is words[starts[r] : starts[r + 1]]."""

    words: Uint32
    starts: IntArray


def colours_of(bits: Uint32) -> NDArray[np.float32]:
    """Decode colours (…,) -> (…, 3). The two highest bits name the largest channel, whose value is 2^(e − 63).

    The next 6 bits hold e. Two shares of 12 bits each give the next two channels, relative to the largest.
    """
    largest = (bits >> 30).astype(np.int64)
    shares = np.ones((*bits.shape, 3), np.float32)
    for after, shift in ((1, 12), (2, 0)):
        part = (bits >> shift & FULL).astype(np.float32) / np.float32(FULL)
        np.put_along_axis(shares, ((largest + after) % 3)[..., None], part[..., None], axis=-1)
    return np.asarray(shares * np.exp2((bits >> 24 & HIGHEST).astype(np.float32) - HIGHEST)[..., None])


def unpacked_words(made: Words) -> tuple[IntArray, NDArray[np.int32], NDArray[np.int32], NDArray[np.int16]]:
    """Return indptr, indices, codes and trust of every run, as in SmallMap; the inverse of word_runs.in_words."""
    kinds, step = parsed(made.words)
    entry = np.flatnonzero((kinds != OTHERS) & (kinds != JUMP) & (kinds != TRUST))
    passed = np.concatenate([[0], np.cumsum(step)])
    kind, bits = kinds[entry], made.words[entry].astype(np.int64)
    indptr = np.searchsorted(entry, made.starts)
    run = np.repeat(np.arange(indptr.size - 1), np.diff(indptr))
    indices = (passed[entry + 1] - passed[made.starts[run]]).astype(np.int32)
    codes = _number(bits >> 16)[:, None] * (kind[:, None] >> np.arange(3) & 1)
    wide = np.flatnonzero(kind == THREE)
    others = made.words[entry[wide] + 1].astype(np.int64)
    codes[wide] = np.stack([_number(bits[wide] >> 16), _number(others & 0xFFFF), _number(others >> 16)], axis=1)
    trust = np.full(indptr.size - 1, FULL_TRUST, np.int16)
    doubted = np.flatnonzero(kinds == TRUST)
    trust[np.searchsorted(made.starts, doubted, side="right") - 1] = made.words[doubted] >> 16
    return indptr, indices, codes.astype(np.int32), trust


def parsed(words: Uint32) -> tuple[NDArray[np.int8], IntArray]:
    """Return each word's kind and step in pixels. The second word of a THREE has the kind OTHERS.

    The second word may itself look like a THREE. In a sequence of words that look so, every second word is a THREE.
    """
    kinds = (words & 7).astype(np.int8)
    at = np.arange(words.size)
    three = kinds == THREE
    three &= (at - np.maximum.accumulate(np.where(three, -1, at))) % 2 == 1
    after = np.flatnonzero(three[:-1]) + 1
    kinds[after] = OTHERS
    step = np.where(kinds == JUMP, words >> 3, words >> 3 & FARTHEST_STEP).astype(np.int64)
    step[(kinds == OTHERS) | (kinds == TRUST)] = 0
    return kinds, step


def _number(bits: IntArray) -> IntArray:
    """Decode codes from their 16 bits."""
    exponent, fraction = bits >> FRACTION_BITS & 7, bits & (1 << FRACTION_BITS) - 1
    size = np.where(exponent == 0, fraction, (fraction | 1 << FRACTION_BITS) << np.maximum(exponent - 1, 0))
    return np.asarray(np.where(bits >> 15 & 1, -size, size))
