"""The contract of build and player: the format of T, Tᵀ, T⁺ and their factors as two textures each (thesis 5.2).

A row of the matrix computes one pixel of the output picture: out[i] = Σ_k weight[k] · source[index[k]], per channel.
The *lookup texture* (output resolution) holds the start and the length of each row. The *entries texture* holds (w_R,
w_G, w_B, index) with index = x + y·width of the source picture. Rows are sorted by length and never break across
texture rows. A texture is at most 16384 texels wide, and as high as necessary. Textures are processed in blocks, so
that memory holds each texture only once. This module writes and reads the format; counterlight.passes.product applies
it.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from io import BufferedReader
from math import prod
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight import memory
from counterlight.arrays import brief
from counterlight.errors import InputError
from counterlight.files import exr, reading
from counterlight.files.exr_header import MAX_PIXELS
from counterlight.files.tables import Table
from counterlight.maps.shelves import MOST_TEXELS, SHORTEN, place_rows

MAX_TEXTURE_WIDTH = 16384  # limit of OpenGL implementations of the last fifteen years, llvmpipe included.
MAX_FLOAT_INDEX = 1 << 24  # smaller integers are exact in float32, so an index fits the alpha channel
TEXEL_BYTES = 16
BLOCK = 1 << 22  # entries that are processed at a time
LOOKUP_CHANNELS, ENTRIES_CHANNELS = ("X", "Y", "LENGTH"), ("R", "G", "B", "A")

UintArray = NDArray[np.uint32]
FloatArray = NDArray[np.float32]
OpenFile: TypeAlias = Callable[[Path], AbstractContextManager[BufferedReader]]


@dataclass(frozen=True)
class SparseRows:
    """Sparse matrices in compressed rows, one per channel, with shared indices; they multiply pictures (pixels, 3).

    indptr : (rows + 1,).
    indices : (entries,). Source pixel.
    weights : (entries, 3), float32 or float64.
    columns : number of source pixels.
    """

    indptr: NDArray[np.integer]
    indices: NDArray[np.integer]
    weights: NDArray[np.floating]
    columns: int

    __repr__ = brief

    @classmethod
    def empty(cls, rows: int, columns: int) -> "SparseRows":
        """Return rows without entries, float32."""
        return cls(np.zeros(rows + 1, np.int64), np.empty(0, np.int32), np.empty((0, 3), np.float32), columns)

    @property
    def shape(self) -> tuple[int, int]:
        return self.indptr.size - 1, self.columns

    @property
    def lengths(self) -> NDArray[np.int64]:
        return np.diff(self.indptr).astype(np.int64, copy=False)

    @property
    def rows(self) -> NDArray[np.int64]:
        """The row of each entry, (entries,)."""
        return np.repeat(np.arange(self.shape[0]), self.lengths)

    @cached_property
    def transposed(self) -> "SparseRows":
        """The transposes, stored as rows, because gathering is twice as fast as scattering."""
        from counterlight.maps.products import transpose

        indptr, indices, weights = transpose(*self._operands, self.columns)
        return SparseRows(indptr, indices, weights, self.shape[0])

    @cached_property
    def _operands(self) -> tuple[NDArray[np.uint64], NDArray[np.uint32], NDArray[np.floating]]:
        """Operands with unsigned indices. Numba then omits a wraparound check, which saves a sixth of the time."""
        indptr, indices = self.indptr.astype(np.int64, copy=False), self.indices.astype(np.int32, copy=False)
        return indptr.view(np.uint64), indices.view(np.uint32), np.ascontiguousarray(self.weights)

    def apply(self, source: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return Σ_k weights[k] source[indices[k]] of every row: (source pixels, 3) -> (rows, 3), summed in float64."""
        # imported only when needed, because importing Numba takes half a second
        from counterlight.maps.products import product_of_channels

        if source.shape != (self.columns, 3):
            raise ValueError(f"{source.shape[0]} values of shape {source.shape[1:]}, expected ({self.columns}, 3)")
        return product_of_channels(*self._operands, np.ascontiguousarray(source))

    def apply_transpose(self, picture: NDArray[np.floating]) -> NDArray[np.float64]:
        """Multiply by the transpose: (rows, 3) -> (source pixels, 3)."""
        return self.transposed.apply(picture)

    def sums(self) -> NDArray[np.float64]:
        """Return the sum of every row, (rows, 3). `apply` to a picture of ones gives the same, but needs Numba."""
        rows, count = self.rows, self.shape[0]
        sums = np.stack([np.bincount(rows, weights, count) for weights in self.weights.T], axis=1)
        return sums.astype(np.float64, copy=False)  # empty sums are integers, for which callers would compile again

    def where(self, keep: NDArray[np.bool_]) -> "SparseRows":
        """Keep only some entries. keep : (entries,) bool."""
        if keep.all():
            return self
        kept_before = np.concatenate([[0], np.cumsum(keep)])
        return SparseRows(kept_before[self.indptr], self.indices[keep], self.weights[keep], self.columns)

    def at(self, rows: NDArray[np.integer]) -> "SparseRows":
        """Return some rows, in the given order."""
        lengths = self.lengths[rows]
        starts = np.concatenate([[0], np.cumsum(lengths)])
        entries = np.repeat(self.indptr[rows] - starts[:-1], lengths) + np.arange(starts[-1])
        return SparseRows(starts, self.indices[entries], self.weights[entries], self.columns)

    def of_columns(self, chosen: NDArray[np.integer]) -> "SparseRows":
        """Return some columns. chosen : (n,), ascending."""
        place = np.full(self.columns, -1, np.int32)
        place[chosen] = np.arange(chosen.size)
        kept = self.where(place[self.indices] >= 0)
        return replace(kept, indices=place[kept.indices], columns=chosen.size)

    def ascending(self) -> "SparseRows":
        """Sort the entries of each row by column."""
        rises = np.diff(self.indices, prepend=-1) > 0
        rises[self.indptr[:-1][self.lengths > 0]] = True
        if rises.all():
            return self
        order = np.lexsort((self.indices, self.rows))
        return replace(self, indices=self.indices[order], weights=self.weights[order])

    def inside(self, mask: NDArray[np.bool_]) -> "SparseRows":
        """Empty the rows outside a mask (rows,), and drop entries of 0."""
        return self.where((self.weights != 0).any(axis=1) & mask[self.rows])

    def scaled(self, factors: NDArray[np.floating]) -> "SparseRows":
        """Scale each row by its factor, (rows,) or per channel (rows, 3); rows with factor 0 become empty."""
        if np.all(factors == 1):
            return self
        each = factors.reshape(self.shape[0], -1)
        kept = self.inside(np.asarray((each > 0).any(axis=1)))
        rows, weights = kept.rows, np.empty_like(kept.weights)
        for channel, factor in enumerate(np.broadcast_to(each.T, (3, self.shape[0]))):
            weights[:, channel] = kept.weights[:, channel] * factor[rows]
        return replace(kept, weights=weights)


def below_each_other(bands: Sequence[SparseRows]) -> SparseRows:
    """Stack the rows of several bands."""
    lengths = np.concatenate([band.lengths for band in bands])
    indices, weights = (np.concatenate([getattr(band, name) for band in bands]) for name in ("indices", "weights"))
    return SparseRows(np.concatenate([[0], np.cumsum(lengths)]), indices, weights, bands[0].columns)


def next_to_each_other(left: SparseRows, right: SparseRows) -> SparseRows:
    """Join the columns of two matrices: each row has its entries of `left`, then of `right`."""
    indptr, pair = left.indptr + right.indptr, (left, right)
    before = right.indptr[:-1], left.indptr[1:]
    places = [
        np.repeat(first, rows.lengths) + np.arange(rows.indices.size) for first, rows in zip(before, pair, strict=True)
    ]
    indices = np.empty(indptr[-1], np.int32)
    weights = np.empty((indptr[-1], 3), np.result_type(left.weights, right.weights))
    for place, rows, first in zip(places, pair, (0, left.columns), strict=True):
        indices[place] = rows.indices + first
        weights[place] = rows.weights
    return SparseRows(indptr, indices, weights, left.columns + right.columns)


@dataclass(frozen=True)
class RowMap:
    """A packed sparse matrix.

    lookup : (output height, output width, 3) uint32. (x, y, length) of each row's first entry.
    entries : (texture height, texture width, 4) float32. (w_R, w_G, w_B, index).
    source_shape : (height, width) of the picture that the indices address.
    index : (texture height, texture width) uint32, only if the source has more than 2²⁴ pixels; alpha is then 0.
    """

    lookup: UintArray
    entries: FloatArray
    source_shape: tuple[int, int]
    index: UintArray | None = None

    __repr__ = brief

    @property
    def output_shape(self) -> tuple[int, int]:
        return self.lookup.shape[0], self.lookup.shape[1]

    @property
    def count(self) -> int:
        """Number of entries in use."""
        return int(self.lookup[..., 2].sum(dtype=np.int64))

    @property
    def fill(self) -> float:
        """Share of the entries texture in use."""
        return self.count / float(self.entries.shape[0] * self.entries.shape[1])

    @property
    def nbytes(self) -> int:
        return self.lookup.nbytes + self.entries.nbytes + (0 if self.index is None else self.index.nbytes)


def pack(
    rows: SparseRows,
    output_shape: tuple[int, int],
    source_shape: tuple[int, int],
    max_texture_width: int = MAX_TEXTURE_WIDTH,
) -> RowMap:
    """Pack a matrix: its rows are the output's pixels, its columns the source's, both row by row from the top.

    Entries with three zero weights are dropped. Raises InputError for weights that are not finite, for a row longer
    than the widest texture, and for more entries than a map or memory holds.
    """
    with np.errstate(over="ignore"):  # values beyond float32 become infinity, which is refused
        rows = replace(rows, weights=rows.weights.astype(np.float32, copy=False))
    rows = rows.where(np.asarray(rows.weights.any(axis=1)))
    height, width = output_shape
    lengths = rows.lengths
    if lengths.size != height * width:
        raise ValueError(f"{lengths.size} rows for an output of {width}x{height} pixels")
    _refuse_not_finite(rows, width)
    longest = int(lengths.argmax())
    if lengths[longest] > max_texture_width:
        raise InputError(
            f"row map: the row of output pixel ({longest % width}, {longest // width}) has {lengths[longest]} entries, "
            f"the widest texture holds {max_texture_width}; {SHORTEN}"
        )
    memory.check(TEXEL_BYTES * rows.indices.size, f"row map: packing {rows.indices.size} entries", SHORTEN)
    x, y, texture_shape = place_rows(lengths, max_texture_width)
    lookup = np.stack([x, y, lengths], axis=-1).astype(np.uint32).reshape(height, width, 3)
    entries = np.zeros((*texture_shape, 4), np.float32)
    wide = source_shape[0] * source_shape[1] > MAX_FLOAT_INDEX
    packed = RowMap(lookup, entries, source_shape, np.zeros(texture_shape, np.uint32) if wide else None)
    indices = entries[..., 3] if packed.index is None else packed.index
    for some, _, texels in _places(packed):
        entries.reshape(-1, 4)[texels, :3] = rows.weights[some]
        indices[np.divmod(texels, texture_shape[1])] = rows.indices[some]
    return packed


def unpack(packed: RowMap) -> SparseRows:
    """Return the matrix that `pack` received, without zero entries."""
    from counterlight.maps.products import unpack_entries  # imports Numba, which takes half a second

    indptr, (height, width) = _indptr(packed), packed.source_shape
    rows = SparseRows(indptr, np.empty(indptr[-1], np.int32), np.empty((indptr[-1], 3), np.float32), height * width)
    index = np.zeros((0, 0), np.uint32) if packed.index is None else packed.index
    unpack_entries(packed.lookup.reshape(-1, 3), packed.entries, index, indptr, rows.indices, rows.weights)
    return rows


def in_blocks(packed: RowMap) -> Iterator[tuple[slice, SparseRows]]:
    """Yield the matrix in bands of rows: the slice of all entries, and the rows."""
    for some, indptr, texels in _places(packed):
        yield some, _at(packed, indptr, texels)


def _at(packed: RowMap, indptr: NDArray[np.int64], texels: NDArray[np.int64]) -> SparseRows:
    """Return rows that start at `indptr` within the entries in `texels`."""
    entries = packed.entries.reshape(-1, 4)[texels]
    indices = entries[:, 3] if packed.index is None else packed.index.ravel()[texels]
    columns = packed.source_shape[0] * packed.source_shape[1]
    return SparseRows(indptr, indices.astype(np.int32), np.ascontiguousarray(entries[:, :3]), columns)


def rows_of(packed: RowMap, part: tuple[slice, slice]) -> SparseRows:
    """Return the rows of a part of the output picture."""
    return _looked_up(packed, packed.lookup[part].reshape(-1, 3))


def rows_between(packed: RowMap, first: int, last: int) -> SparseRows:
    """Return the rows of consecutive output pixels; `last` is exclusive."""
    return _looked_up(packed, packed.lookup.reshape(-1, 3)[first:last])


def _looked_up(packed: RowMap, lookup: UintArray) -> SparseRows:
    x, y, lengths = lookup.astype(np.int64).T
    indptr, first = np.concatenate([[0], np.cumsum(lengths)]), y * packed.entries.shape[1] + x
    return _at(packed, indptr, np.repeat(first - indptr[:-1], lengths) + np.arange(indptr[-1]))


def _places(packed: RowMap) -> Iterator[tuple[slice, NDArray[np.int64], NDArray[np.int64]]]:
    """Yield bands of rows: the slice of all entries, the start of each row within it, and the texels."""
    indptr, width = _indptr(packed), packed.entries.shape[1]
    lookup = packed.lookup.reshape(-1, 3)
    for first, last in bands(indptr):
        x, y, lengths = lookup[first:last].astype(np.int64).T
        starts = indptr[first : last + 1] - indptr[first]
        texels = np.repeat(y * width + x - starts[:-1], lengths) + np.arange(starts[-1])
        yield slice(int(indptr[first]), int(indptr[last])), starts, texels


def bands(indptr: NDArray[np.integer]) -> Iterator[tuple[int, int]]:
    """Yield (first, last) of bands of at most BLOCK entries, `last` exclusive. A longer row is a band by itself."""
    first = 0
    while first < indptr.size - 1:
        last = max(first + 1, int(np.searchsorted(indptr, indptr[first] + BLOCK, side="right")) - 1)
        yield first, last
        first = last


def _indptr(packed: RowMap) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(packed.lookup[..., 2].ravel(), dtype=np.int64)])


def write(packed: RowMap, folder: Path) -> dict[str, Any]:
    """Write lookup.exr and entries.exr (and index.exr) into `folder`; returns the sizes for the manifest."""
    folder.mkdir(parents=True, exist_ok=True)
    exr.write_plain(folder / "lookup.exr", {c: packed.lookup[..., i] for i, c in enumerate(LOOKUP_CHANNELS)})
    exr.write_plain(folder / "entries.exr", {c: packed.entries[..., i] for i, c in enumerate(ENTRIES_CHANNELS)})
    if packed.index is not None:
        exr.write_plain(folder / "index.exr", {"INDEX": packed.index})
    return {
        "output": size_of(packed.output_shape),
        "source": size_of(packed.source_shape),
        "texture": size_of((packed.entries.shape[0], packed.entries.shape[1])),
        "entries": packed.count,
        "wide_index": packed.index is not None,
    }


def read(folder: Path, sizes: Table, opened: OpenFile | None = None) -> RowMap:
    """Read the files of `write`, and check them against the manifest's `sizes` and for consistency.

    opened : function that opens a file, for example with a checksum test.

    Raises InputError for anything that would let a shader read a wrong or missing texel.
    """
    output, source, texture = shapes(sizes)
    opened = opened or partial(reading.opened, fix=sizes.fix)
    wide = sizes.truth("wide_index", False)
    if not wide and prod(source) > MAX_FLOAT_INDEX:
        raise sizes.refusal(f": {prod(source)} source pixels need the wide index texture")

    def channels(
        name: str, names: tuple[str, ...], shape: tuple[int, int], dtype: type, look: exr.Look
    ) -> NDArray[Any]:
        with opened(folder / name) as file:
            return read_texture(file, names, shape, dtype, look, sizes.fix)

    def entries_are_sound(rows: NDArray[Any]) -> None:
        if not np.isfinite(rows).all():
            raise InputError(f"{folder}: the entries hold NaN or infinity; {sizes.fix}")
        if not wide:
            indices_are_sound(rows[..., 3])

    def indices_are_sound(index: NDArray[Any]) -> None:
        if index.min() < 0 or index.max() >= prod(source) or np.any(index != np.floor(index)):
            raise InputError(f"{folder}: an index lies outside the {prod(source)} source pixels; {sizes.fix}")

    lookup = channels("lookup.exr", LOOKUP_CHANNELS, output, np.uint32, _LookupCheck(texture, folder, sizes.fix))
    entries = channels("entries.exr", ENTRIES_CHANNELS, texture, np.float32, entries_are_sound)
    if not wide:
        return RowMap(lookup, entries, source)
    index = channels("index.exr", ("INDEX",), texture, np.uint32, indices_are_sound)
    return RowMap(lookup, entries, source, index[..., 0])


def shapes(sizes: Table) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
    """Return (height, width) of a map's output, source and entries texture, as its manifest states them."""
    output, source = (sizes.size(key, MAX_PIXELS) for key in ("output", "source"))
    return output, source, sizes.size("texture", MOST_TEXELS)


class _LookupCheck:
    """Checks rows of a lookup texture; raises InputError for rows outside the entries texture, or overlapping rows."""

    def __init__(self, texture: tuple[int, int], where: Path, fix: str) -> None:
        self._height, self._width = texture
        self._where, self._fix, self._count = where, fix, 0

    def __call__(self, rows: UintArray) -> None:
        x, y, length = (rows[..., i].astype(np.int64) for i in range(3))
        size = f"{self._width}x{self._height}"
        if np.any((length > 0) & ((x + length > self._width) | (y >= self._height))):
            raise InputError(f"{self._where}: a lookup entry points outside the {size} entries texture; {self._fix}")
        self._count += int(length.sum())
        if self._count > self._height * self._width:
            found = f"rows of {self._count} entries in {size} texels"
            raise InputError(f"{self._where}: {found}, so they overlap; {self._fix}")


def _refuse_not_finite(rows: SparseRows, width: int) -> None:
    finite = np.isfinite(rows.weights).all(axis=1)
    if not finite.all():
        pixel = int(np.searchsorted(rows.indptr, int(finite.argmin()), side="right")) - 1
        raise InputError(
            f"row map: the row of output pixel ({pixel % width}, {pixel // width}) holds NaN or infinity, or a weight "
            "beyond float32; give more --regularize, or look for what is extreme in the calibration"
        )


def read_texture(
    file: BufferedReader, names: tuple[str, ...], shape: tuple[int, int], dtype: type, look: exr.Look, fix: str
) -> NDArray[Any]:
    def accept(header: exr.Header, name: str) -> None:
        if (header.height, header.width) != shape or set(header.channels) != set(names):
            raise InputError(
                f"{name}: {header.width}x{header.height} texels of {'/'.join(header.channels)}, "
                f"the manifest promises {shape[1]}x{shape[0]} of {'/'.join(names)}; {fix}"
            )

    def of_the_type(rows: NDArray[Any]) -> None:
        if rows.dtype != dtype:
            raise InputError(f"{file.name}: its channels are not {np.dtype(dtype).name}; {fix}")
        look(rows)

    return exr.read_stacked(file, names, accept, of_the_type, MOST_TEXELS)


def size_of(shape: tuple[int, int]) -> list[int]:
    return [shape[1], shape[0]]


class PreparedRows:
    """A row map unpacked for repeated products in float64: per channel Σ_k weight[k] · source[index[k]].

    Rows without entries give 0.
    """

    def __init__(self, packed: RowMap) -> None:
        self._rows = unpack(packed)
        self._shape, self._source_shape = packed.output_shape, packed.source_shape

    def apply(self, source: NDArray[np.floating]) -> NDArray[np.float64]:
        """Multiply. source : (source height, source width, 3). Returns (output height, output width, 3)."""
        if source.shape[:2] != self._source_shape:
            raise ValueError(f"source of shape {source.shape[:2]}, the row map reads {self._source_shape}")
        return self._rows.apply(source.reshape(-1, 3)).reshape(*self._shape, 3)

    def apply_transpose(self, picture: NDArray[np.floating]) -> NDArray[np.float64]:
        """Multiply a picture of the output's shape by the transpose; returns a picture of the source's shape."""
        return self._rows.apply_transpose(picture.reshape(-1, 3)).reshape(*self._source_shape, 3)
