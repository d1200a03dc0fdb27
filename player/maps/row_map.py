"""THE CONTRACT: a sparse matrix as two textures (thesis 5.2), one for all of T, Tᵀ, T⁺ and their parts.

A row of the matrix makes one pixel of the output picture: out[i] = Σ_k weight[k] · source[index[k]], per channel.
The *lookup texture* (output resolution) says where a row starts and how long it is; the *entries texture* holds
(w_R, w_G, w_B, index) with index = x + y·width of the source picture. Rows are sorted by length and never break across
texture rows. The format is written and read here; shaders/row_map.frag applies it, pipeline/reference.py is its twin.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from io import BufferedReader
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.files import exr, reading
from counterlight.files.exr_header import MAX_PIXELS
from counterlight.files.tables import Table

MAX_TEXTURE_WIDTH = 16384  # OpenGL implementations of the last fifteen years, llvmpipe included
SHORTEN = "shorten the rows with --max-cluster, or a larger --max-error or --regularize"
MAX_FLOAT_INDEX = 1 << 24  # every integer below is exact in a float32, so an index fits the alpha channel
GOOD_FILL = 0.99
LOOKUP_CHANNELS, ENTRIES_CHANNELS = ("X", "Y", "LENGTH"), ("R", "G", "B", "A")

UintArray = NDArray[np.uint32]
FloatArray = NDArray[np.float32]
OpenFile: TypeAlias = Callable[[Path], AbstractContextManager[BufferedReader]]


@dataclass(frozen=True)
class SparseRows:
    """A sparse matrix for each of three channels, all of one pattern, in compressed rows; it applies to (pixels, 3).

    indptr : (rows + 1,).  indices : (entries,), the source pixel.  weights : (entries, 3), float32 or float64.
    columns : source pixels.
    """

    indptr: NDArray[np.integer]
    indices: NDArray[np.integer]
    weights: NDArray[np.floating]
    columns: int

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
        """The transposes, as rows: gathering is twice as fast as scattering."""
        from counterlight.maps.products import transpose

        return SparseRows(*transpose(*self._operands, self.columns), self.shape[0])

    @cached_property
    def _operands(self) -> tuple[NDArray[np.uint64], NDArray[np.uint32], NDArray[np.floating]]:
        """Unsigned, so that Numba need not look whether they count from the end: a sixth less time."""
        indptr, indices = self.indptr.astype(np.int64, copy=False), self.indices.astype(np.int32, copy=False)
        return indptr.view(np.uint64), indices.view(np.uint32), np.ascontiguousarray(self.weights)

    def apply(self, source: NDArray[np.floating]) -> NDArray[np.float64]:
        """Σ_k weights[k] source[indices[k]] of every row: (source pixels, 3) -> (rows, 3), summed in float64."""
        from counterlight.maps.products import product_of_channels  # Numba takes half a second: not before it is used

        if source.shape != (self.columns, 3):
            raise ValueError(f"{source.shape[0]} values of shape {source.shape[1:]}, expected ({self.columns}, 3)")
        return product_of_channels(*self._operands, np.ascontiguousarray(source))

    def apply_transpose(self, picture: NDArray[np.floating]) -> NDArray[np.float64]:
        """(rows, 3) -> (source pixels, 3)."""
        return self.transposed.apply(picture)

    def sums(self) -> NDArray[np.float64]:
        """Of every row, (rows, 3): what `apply` makes of ones, without Numba."""
        rows, count = self.rows, self.shape[0]
        return np.stack([np.bincount(rows, weights, count) for weights in self.weights.T], axis=1)

    def where(self, keep: NDArray[np.bool_]) -> "SparseRows":
        """Those entries only, (entries,)."""
        if keep.all():
            return self
        kept_before = np.concatenate([[0], np.cumsum(keep)])
        return SparseRows(kept_before[self.indptr], self.indices[keep], self.weights[keep], self.columns)

    def inside(self, mask: NDArray[np.bool_]) -> "SparseRows":
        """The other rows left empty, (rows,), and entries of 0 left out."""
        return self.where((self.weights != 0).any(axis=1) & mask[self.rows])

    def scaled(self, factors: NDArray[np.floating]) -> "SparseRows":
        """Each row times its factor, (rows,), or one for each channel, (rows, 3); empty where that is 0."""
        if np.all(factors == 1):
            return self
        each = factors.reshape(self.shape[0], -1)
        kept = self.inside(np.asarray((each > 0).any(axis=1)))
        return replace(kept, weights=(kept.weights * each[kept.rows]).astype(self.weights.dtype))


@dataclass(frozen=True)
class RowMap:
    """A packed sparse matrix.

    lookup : (output height, output width, 3) uint32, the (x, y, length) of each row's first entry.
    entries : (texture height, texture width, 4) float32, (w_R, w_G, w_B, index).
    source_shape : (height, width) of the picture that the indices address.
    index : (texture height, texture width) uint32, only if the source has more than 2²⁴ pixels; alpha is then 0.
    """

    lookup: UintArray
    entries: FloatArray
    source_shape: tuple[int, int]
    index: UintArray | None = None

    @property
    def output_shape(self) -> tuple[int, int]:
        return self.lookup.shape[0], self.lookup.shape[1]

    @property
    def count(self) -> int:
        """Entries in use."""
        return int(self.lookup[..., 2].sum(dtype=np.int64))

    @property
    def fill(self) -> float:
        """Share of the entries texture that is in use."""
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

    Entries whose three weights are all zero are left out.
    Raises InputError for weights that are not finite, if a row is longer than the widest texture, and if the texture
    would be too high.
    """
    with np.errstate(over="ignore"):  # beyond float32 becomes infinity, which is refused
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
    x, y, texture_shape = _place_rows(lengths, max_texture_width)
    lookup = np.stack([x, y, lengths], axis=-1).astype(np.uint32).reshape(height, width, 3)
    texel = np.repeat(y * texture_shape[1] + x - rows.indptr[:-1], lengths) + np.arange(rows.indices.size)
    entries = np.zeros((texture_shape[0] * texture_shape[1], 4), np.float32)
    entries[texel, :3] = rows.weights
    index: UintArray | None = None
    if source_shape[0] * source_shape[1] <= MAX_FLOAT_INDEX:
        entries[texel, 3] = rows.indices
    else:
        index = np.zeros(texture_shape, np.uint32)
        index.ravel()[texel] = rows.indices
    return RowMap(lookup, entries.reshape(*texture_shape, 4), source_shape, index)


def unpack(packed: RowMap) -> SparseRows:
    """The matrix that `pack` was given, its zero entries left out."""
    x, y, lengths = (packed.lookup[..., i].ravel().astype(np.int64) for i in range(3))
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    texel = np.repeat(y * packed.entries.shape[1] + x - indptr[:-1], lengths) + np.arange(indptr[-1])
    entries = packed.entries.reshape(-1, 4)[texel]
    indices = entries[:, 3] if packed.index is None else packed.index.ravel()[texel]
    height, width = packed.source_shape
    return SparseRows(indptr, indices.astype(np.int32), np.ascontiguousarray(entries[:, :3]), height * width)


def write(packed: RowMap, folder: Path) -> dict[str, Any]:
    """Write lookup.exr and entries.exr (and index.exr) into `folder`; returns the sizes for the manifest."""
    folder.mkdir(parents=True, exist_ok=True)
    exr.write_channels(folder / "lookup.exr", {c: packed.lookup[..., i] for i, c in enumerate(LOOKUP_CHANNELS)})
    exr.write_channels(folder / "entries.exr", {c: packed.entries[..., i] for i, c in enumerate(ENTRIES_CHANNELS)})
    if packed.index is not None:
        exr.write_channels(folder / "index.exr", {"INDEX": packed.index})
    return {
        "output": _size(packed.output_shape),
        "source": _size(packed.source_shape),
        "texture": _size((packed.entries.shape[0], packed.entries.shape[1])),
        "entries": packed.count,
        "wide_index": packed.index is not None,
    }


def read(folder: Path, sizes: Table, opened: OpenFile | None = None) -> RowMap:
    """Read what `write` wrote and check it against the manifest's `sizes` and against itself.

    opened : how a file is opened, such as by its checksum.
    Raises InputError for anything that would let a shader read a wrong or missing texel.
    """
    output, source, texture = shapes(sizes)
    opened = opened or partial(reading.opened, fix=sizes.fix)

    def channels(name: str, names: tuple[str, ...], shape: tuple[int, int], dtype: type) -> NDArray[Any]:
        with opened(folder / name) as file:
            return _read(file, names, shape, dtype, sizes.fix)

    lookup = channels("lookup.exr", LOOKUP_CHANNELS, output, np.uint32)
    entries = channels("entries.exr", ENTRIES_CHANNELS, texture, np.float32)
    wide = sizes.truth("wide_index", False)
    index = channels("index.exr", ("INDEX",), texture, np.uint32)[..., 0] if wide else None
    packed = RowMap(lookup, entries, source, index)
    _check(packed, folder, sizes.fix)
    return packed


def shapes(sizes: Table) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
    """(height, width) of a map's output, source and entries texture, as its manifest promises them."""
    output, source, texture = (sizes.size(key, MAX_PIXELS) for key in ("output", "source", "texture"))
    return output, source, texture


def _check(packed: RowMap, where: Path, fix: str) -> None:
    """Every row inside the entries texture, every weight finite, every index inside the source picture."""
    height, width = packed.entries.shape[:2]
    x, y, length = (packed.lookup[..., i].astype(np.int64) for i in range(3))
    used = length > 0
    if np.any(used & ((x + length > width) | (y >= height))):
        raise InputError(f"{where}: a lookup entry points outside the {width}x{height} entries texture; {fix}")
    if packed.count > height * width:
        raise InputError(f"{where}: rows of {packed.count} entries in {width}x{height} texels, so they overlap; {fix}")
    if not np.isfinite(packed.entries).all():
        raise InputError(f"{where}: the entries hold NaN or infinity; {fix}")
    source_pixels = packed.source_shape[0] * packed.source_shape[1]
    if packed.index is None and source_pixels > MAX_FLOAT_INDEX:
        raise InputError(f"{where}: {source_pixels} source pixels need the wide index texture; {fix}")
    index = packed.entries[..., 3] if packed.index is None else packed.index
    if index.min() < 0 or index.max() >= source_pixels or np.any(index != np.floor(index)):
        raise InputError(f"{where}: an index lies outside the {source_pixels} source pixels; {fix}")


def _refuse_not_finite(rows: SparseRows, width: int) -> None:
    finite = np.isfinite(rows.weights).all(axis=1)
    if not finite.all():
        pixel = int(np.searchsorted(rows.indptr, int(finite.argmin()), side="right")) - 1
        raise InputError(
            f"row map: the row of output pixel ({pixel % width}, {pixel // width}) holds NaN or infinity, or a weight "
            "beyond float32; give more --regularize, or look for what is extreme in the calibration"
        )


def _place_rows(
    lengths: NDArray[np.int64], max_width: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], tuple[int, int]]:
    """Give each row its (x, y) in the smallest of a few textures, longest rows first; returns x, y, (height, width)."""
    total, longest = int(lengths.sum()), int(lengths.max(initial=0))
    if total == 0:
        zeros = np.zeros(lengths.size, np.int64)
        return zeros, zeros, (1, 1)
    counts = np.bincount(lengths)
    counts[0] = 0
    best: tuple[int, int, list[_Shelf]] | None = None
    for width in _candidate_widths(total, longest, int(counts.argmax()), max_width):
        shelves = _fill_shelves(counts, width)
        height = sum(shelf.repeats for shelf in shelves)
        if height <= MAX_TEXTURE_WIDTH and (best is None or width * height < best[0] * best[1]):
            best = width, height, shelves
        if best is not None and total >= GOOD_FILL * best[0] * best[1]:
            break
    if best is None:
        raise InputError(f"row map: {total} entries do not fit a texture of {max_width}x{MAX_TEXTURE_WIDTH}; {SHORTEN}")
    width, height, shelves = best
    x, y = _coordinates(lengths, shelves)
    return x, y, (height, width)


def _candidate_widths(total: int, longest: int, commonest: int, max_width: int) -> list[int]:
    """Texture widths to try, near square first: multiples of the commonest and the longest row waste least."""
    square = max(longest, int(np.ceil(np.sqrt(total))), -(-total // MAX_TEXTURE_WIDTH))
    widths = []
    for scale in (1.0, 1.5, 2.0, 3.0, 4.0, 8.0, 16.0):
        for unit in (commonest, longest, 1):
            width = -(-int(square * scale) // unit) * unit
            widths.append(min(max(width, longest), max_width))
    return list(dict.fromkeys(widths))


@dataclass(frozen=True)
class _Shelf:
    """Texture rows filled alike: `repeats` rows, each holding `parts` = ((row length, how many), …) from x = 0."""

    repeats: int
    parts: tuple[tuple[int, int], ...]


def _fill_shelves(counts: NDArray[np.int64], width: int) -> list[_Shelf]:
    """Fill texture rows greedily with the longest row that still fits; equal texture rows are found only once."""
    left = counts.copy()
    shelves: list[_Shelf] = []
    while True:
        parts: list[tuple[int, int]] = []
        room = width
        for length in np.flatnonzero(left)[::-1]:
            if length <= room:
                many = int(min(left[length], room // length))
                parts.append((int(length), many))
                room -= many * int(length)
        if not parts:
            return shelves
        repeats = min(int(left[length]) // many for length, many in parts)
        for length, many in parts:
            left[length] -= many * repeats
        shelves.append(_Shelf(repeats, tuple(parts)))


def _coordinates(lengths: NDArray[np.int64], shelves: list[_Shelf]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Hand the shelves' places to the rows: rows of one length take theirs in order, so neighbours stay neighbours."""
    order = np.argsort(lengths, kind="stable")
    next_of_length = np.searchsorted(lengths[order], np.arange(int(lengths.max()) + 1))
    x, y = np.zeros(lengths.size, np.int64), np.zeros(lengths.size, np.int64)
    top = 0
    for shelf in shelves:
        left = 0
        for length, many in shelf.parts:
            first = next_of_length[length]
            taken = order[first : first + many * shelf.repeats]
            next_of_length[length] += taken.size
            x[taken] = left + length * np.tile(np.arange(many), shelf.repeats)
            y[taken] = top + np.repeat(np.arange(shelf.repeats), many)
            left += length * many
        top += shelf.repeats
    return x, y


def _read(file: BufferedReader, names: tuple[str, ...], shape: tuple[int, int], dtype: type, fix: str) -> NDArray[Any]:
    def accept(header: exr.Header, name: str) -> None:
        if (header.height, header.width) != shape or set(header.channels) != set(names):
            raise InputError(
                f"{name}: {header.width}x{header.height} texels of {'/'.join(header.channels)}, "
                f"the manifest promises {shape[1]}x{shape[0]} of {'/'.join(names)}; {fix}"
            )

    channels = exr.read_channels(file, accept)
    if any(channels[name].dtype != dtype for name in names):
        raise InputError(f"{file.name}: its channels are not {np.dtype(dtype).name}; {fix}")
    return np.stack([channels[name] for name in names], axis=-1)


def _size(shape: tuple[int, int]) -> list[int]:
    return [shape[1], shape[0]]
