"""Light transport as near light, in sparse rows, plus a sum of chains: blurred light B P and far light U M D.

Light that travels directly, or scatters close by, makes T sparse and sharp. Light that crosses the room reaches
everything but is smooth. Stored by entries it would fill T, so it is kept as U M D (docs/mathematics.md 3). Light of a
lens far out of focus is near, but wide; with many pixels, it is kept as B P (docs/mathematics.md 4). Scipy handles one
channel at a time: `channel` and `channels` return scipy matrices, and `stacked` combines three of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from counterlight.arrays import FloatArray, brief
from counterlight.errors import InputError
from counterlight.maps.chain import Chain, Light, Sum
from counterlight.maps.row_map import SparseRows, below_each_other
from counterlight.passes.colour import LUMINANCE

Csr: TypeAlias = sparse.csr_array  # scipy's stubs make it generic, scipy itself does not
Shape: TypeAlias = tuple[int, int]
CHANNELS = ("red", "green", "blue")
ROWS_AT_ONCE = 256  # rows that are processed at a time for a T that is made dense


@dataclass(frozen=True)
class Dense:
    """A dense matrix per channel. matrices : (3, rows, columns)."""

    matrices: FloatArray

    __repr__ = brief

    @property
    def shape(self) -> tuple[int, int]:
        return self.matrices.shape[1], self.matrices.shape[2]

    @property
    def transposed(self) -> "Dense":
        return Dense(self.matrices.transpose(0, 2, 1))

    def apply(self, source: Light) -> FloatArray:
        """Multiply each channel by its matrix: (columns, 3) -> (rows, 3)."""
        return np.stack([matrix @ source[:, i] for i, matrix in enumerate(self.matrices)], axis=1)

    def apply_transpose(self, picture: Light) -> FloatArray:
        """Multiply by the transpose: (rows, 3) -> (columns, 3)."""
        return self.transposed.apply(picture)


M = TypeVar("M", Dense, None)
Factor: TypeAlias = SparseRows | Dense
LightChain: TypeAlias = Chain[SparseRows, Dense | None]
# U M D. D, (cells, projector pixels): irradiance that arrives directly on each surface cell. M: indirect irradiance on
# a cell per direct irradiance on another, all bounces. U, (camera pixels, cells): radiance per indirect irradiance.
FarLight: TypeAlias = Chain[SparseRows, Dense]
# B P. P, (cells, projector pixels): means over blocks. B, (camera pixels, cells): radiance per mean.
BlurredLight: TypeAlias = Chain[SparseRows, None]


def far_light_of(gather: Sequence[Csr], mix: FloatArray, scatter: Sequence[Csr]) -> FarLight:
    """Return U M D from D and U as three scipy matrices each, and M as (3, cells, cells)."""
    return FarLight(stacked(gather), Dense(mix), stacked(scatter))


def transposed(chain: Chain[SparseRows, M] | None) -> Chain[SparseRows, M] | None:
    """Return Dᵀ Mᵀ Uᵀ or Pᵀ Bᵀ; None for None."""
    if chain is None:
        return None
    mix = None if chain.mix is None else chain.mix.transposed
    return Chain(chain.scatter.transposed, mix, chain.gather.transposed)


@dataclass(frozen=True)
class Transport:
    """T of one projector and one camera, c = T p: near light S, and far light U M D and blurred light B P if any.

    T acts on linear floating-point light: `T @ p`, `T.T @ c`. Light is (pixels, 3) or, if T knows its pictures' sizes,
    a picture (height, width, 3). Other shapes raise InputError; so do integers, which may be code values. A square
    picture cannot be distinguished from its transpose.

    near : (camera pixels, projector pixels), float32. Radiance per unit drive, ≥ 0.
    camera, projector : (height, width); None if unknown.
    """

    near: SparseRows
    far: FarLight | None = None
    camera: Shape | None = None
    projector: Shape | None = None
    blurred: BlurredLight | None = None

    def __repr__(self) -> str:
        far = "" if self.far is None else f", far light of {self.far.scatter.columns} cells"
        blurred = "" if self.blurred is None else f", blurred light of {self.blurred.scatter.columns} cells"
        return f"<Transport {self.shape}: {self.near.indices.size} entries{far}{blurred}>"

    @classmethod
    def from_matrices(
        cls,
        near: Sequence[Csr],
        far: FarLight | None = None,
        *,
        camera: Shape | None = None,
        projector: Shape | None = None,
    ) -> "Transport":
        """Make a T from S as scipy matrices for red, green and blue, (camera pixels, projector pixels) each."""
        return cls(stacked(near), far, camera, projector)

    @property
    def shape(self) -> tuple[int, int]:
        return self.near.shape

    @property
    def without_far(self) -> "Transport":
        """S + B P."""
        return replace(self, far=None)

    @property
    def entries(self) -> int:
        """Number of entries of S and B."""
        return int(self.near.indices.size + (0 if self.blurred is None else self.blurred.scatter.indices.size))

    @property
    def chains(self) -> list[LightChain]:
        """B P and U M D, if any."""
        return [chain for chain in (self.blurred, self.far) if chain is not None]

    def apply(self, drive: ArrayLike) -> FloatArray:
        """Return T p, without ambient light: (projector pixels, 3) -> (camera pixels, 3), or picture -> picture."""
        light = np.asarray(drive)
        rows = _rows(light, self.shape[1], self.projector)
        return _alike(Sum([self.near, *self.chains]).apply(rows), light, self.camera)

    def apply_transpose(self, picture: ArrayLike) -> FloatArray:
        """Return Tᵀ c, the dual picture (thesis eq. 3.12): (camera pixels, 3) -> (projector pixels, 3), or pictures."""
        return self.T.apply(picture)

    def __matmul__(self, drive: ArrayLike) -> FloatArray:
        light = np.asarray(drive)
        if light.dtype.kind not in "fb":
            raise InputError(f"light as {light.dtype}, expected linear light in floating point; convert it first")
        return self.apply(light)

    @cached_property
    def T(self) -> "Transport":  # noqa: N802 - as numpy calls it
        """Tᵀ."""
        far, blurred = transposed(self.far), transposed(self.blurred)
        return Transport(self.near.transposed, far, self.projector, self.camera, blurred)

    def composition(self) -> FloatArray:
        """Return T·1, the floodlit room without ambient light: (camera pixels, 3)."""
        near, ones = self.near.sums(), np.ones((self.shape[1], 3))
        return near + Sum(self.chains).apply(ones) if self.chains else near

    def floodlight(self, ambient: NDArray[np.floating]) -> FloatArray:
        """Return T·1 + e, the floodlit room as the camera sees it, in the shape of e."""
        return self.composition().reshape(ambient.shape) + ambient

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Projector pixels whose near or blurred light any camera pixel sees, (projector pixels, 3) bool."""
        lit = _lit(self.near)
        if self.blurred is not None:
            cells = _lit(self.blurred.scatter).astype(np.float64)
            lit |= self.blurred.gather.apply_transpose(cells) > 0
        return lit

    def at(self, rows: NDArray[np.integer]) -> "Transport":
        """Return T of some camera pixels, in the given order; the result has no camera picture size."""
        return replace(self, camera=None).by_rows(lambda all_rows: all_rows.at(rows))

    def inside(self, mask: NDArray[np.bool_]) -> "Transport":
        """Return T with empty rows outside a mask of camera pixels; entries of 0 are dropped."""
        return self.by_rows(lambda rows: rows.inside(mask.ravel()))

    def of_columns(self, chosen: NDArray[np.integer]) -> "Transport":
        """Return T of some projector pixels, (n,) ascending, without far light; unused cells are dropped."""
        near, blurred = self.near.of_columns(chosen), self.blurred
        if blurred is not None:
            cells = np.unique(blurred.scatter.indices)
            gather = blurred.gather.at(cells).of_columns(chosen)
            blurred = BlurredLight(gather, None, blurred.scatter.of_columns(cells))
        return Transport(near, camera=self.camera, blurred=blurred)

    def by_rows(self, change: Callable[[SparseRows], SparseRows]) -> "Transport":
        """Apply the same change to the rows of S, B and U, for operations on camera pixels."""
        far = None if self.far is None else replace(self.far, scatter=change(self.far.scatter))
        blurred = None if self.blurred is None else replace(self.blurred, scatter=change(self.blurred.scatter))
        return replace(self, near=change(self.near), far=far, blurred=blurred)

    def scaled(self, factors: FloatArray) -> "Transport":
        """Multiply each camera pixel's light by its factor, (camera pixels,) or (camera pixels, 3)."""
        return self.by_rows(lambda rows: rows.scaled(factors))


def in_one(transport: Transport, threshold: float = 0.0) -> SparseRows:
    """Return S + B P + U M D by entries, float32, without zeros and entries of a luminance below `threshold`.

    With far light and no threshold, the result is (almost) dense. Columns in which no pixel of a block can reach the
    threshold by far light are computed only where S has an entry.
    """
    if transport.blurred is not None:
        factors = zip(*(channels(part) for part in (transport.blurred.scatter, transport.blurred.gather)), strict=True)
        wide = [Csr(B @ P + S) for (B, P), S in zip(factors, channels(transport.near), strict=True)]
        return in_one(replace(transport, near=stacked(wide), blurred=None), threshold)
    if transport.far is None:
        return _from(transport.near, threshold)
    near, gather = (channels(part) for part in (transport.near, transport.far.gather))
    bases = [U @ M for U, M in zip(channels(transport.far.scatter), transport.far.mix.matrices, strict=True)]
    blocks = []
    for start in range(0, transport.shape[0], ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        rows, light = [S[some] for S in near], [base[some] for base in bases]
        most = [np.abs(each).max(axis=0) @ abs(D) for each, D in zip(light, gather, strict=True)]
        reached = luminance(np.stack(most, axis=1)) >= threshold
        reached[np.concatenate([S.indices for S in rows])] = True
        sums = [e @ D[:, reached] + S[:, reached].toarray() for e, D, S in zip(light, gather, rows, strict=True)]
        block = dense_rows(np.stack(sums).astype(np.float32)).inside(np.ones(sums[0].shape[0], bool))
        places = np.flatnonzero(reached).astype(np.int32)
        blocks.append(_from(replace(block, indices=places[block.indices], columns=len(reached)), threshold))
    return below_each_other(blocks)


def _from(rows: SparseRows, threshold: float) -> SparseRows:
    """Keep entries of at least that luminance."""
    return rows.where(luminance(rows.weights) >= threshold) if threshold else rows


def stacked(matrices: Sequence[Csr]) -> SparseRows:
    """Return matrices for red, green and blue as rows with one pattern, the union of theirs, sorted by column.

    float32 if all of them are. Raises ValueError for shapes that differ.
    """
    if any(matrix.shape != matrices[0].shape for matrix in matrices):
        raise ValueError(
            f"matrices of shapes {', '.join(str(matrix.shape) for matrix in matrices)}, expected one shape"
        )
    matrices = [_canonical(matrix) for matrix in matrices]
    first, columns = matrices[0], int(matrices[0].shape[1])
    if all(np.array_equal(m.indptr, first.indptr) and np.array_equal(m.indices, first.indices) for m in matrices[1:]):
        weights = np.stack([matrix.data for matrix in matrices], axis=1)
        return SparseRows(first.indptr.astype(np.int64), first.indices.astype(np.int32), _floating(weights), columns)
    bits = [Csr((np.full(m.nnz, 1 << i, np.int8), m.indices, m.indptr), shape=m.shape) for i, m in enumerate(matrices)]
    union = _canonical(Csr(bits[0] + bits[1] + bits[2]))
    weights = np.zeros((union.nnz, 3), np.result_type(*(matrix.dtype for matrix in matrices)))
    for i, matrix in enumerate(matrices):
        weights[union.data & 1 << i > 0, i] = matrix.data  # same order in both
    return SparseRows(union.indptr.astype(np.int64), union.indices.astype(np.int32), _floating(weights), columns)


def channel(rows: SparseRows, i: int) -> Csr:
    """Return the matrix of channel 0, 1 or 2, without entries of 0."""
    matrix = _matrix(rows, rows.weights[:, i].copy())
    matrix.eliminate_zeros()
    return matrix


def channels(rows: SparseRows) -> tuple[Csr, ...]:
    """Return the matrices of red, green and blue."""
    return tuple(channel(rows, i) for i in range(len(CHANNELS)))


def channel_of_chain(chain: LightChain, i: int) -> Chain[Csr, FloatArray | None]:
    """Return the factors of channel 0, 1 or 2."""
    mix = None if chain.mix is None else chain.mix.matrices[i]
    return Chain(channel(chain.gather, i), mix, channel(chain.scatter, i))


def luminance(weights: NDArray[np.floating]) -> FloatArray:
    """Return the BT.709 luminance of (n, 3), float64.

    The sum is written term by term. A matrix product's rounding depends on position, and equal weights must stay equal.
    """
    red, green, blue = (share * weights[:, i].astype(np.float64) for i, share in enumerate(LUMINANCE))
    return np.asarray(red + green + blue)


def luminance_matrix(rows: SparseRows) -> Csr:
    """Return the luminance of the three channels' matrices."""
    return _matrix(rows, luminance(rows.weights).astype(rows.weights.dtype))


def _matrix(rows: SparseRows, data: NDArray[np.floating]) -> Csr:
    """Make a matrix with copied indices, 32-bit if possible: half as many bytes to read in every product."""
    width = np.int32 if max(*rows.shape, rows.indices.size) <= np.iinfo(np.int32).max else np.int64
    return Csr((data, rows.indices.astype(width), rows.indptr.astype(width)), shape=rows.shape)


def dense_rows(matrices: FloatArray) -> SparseRows:
    """Return dense matrices (3, rows, columns) as rows."""
    _, rows, columns = matrices.shape
    weights = np.ascontiguousarray(matrices.reshape(3, -1).T)
    return SparseRows(
        np.arange(rows + 1) * columns, np.tile(np.arange(columns, dtype=np.int32), rows), weights, columns
    )


def _lit(rows: SparseRows) -> NDArray[np.bool_]:
    """Return the columns that have light, (columns, 3)."""
    seen = (np.bincount(rows.indices[each != 0], minlength=rows.columns) for each in rows.weights.T)
    return np.stack(list(seen), axis=1) > 0


def _rows(light: Light, pixels: int, shape: Shape | None) -> Light:
    """Return a picture, or a list, as (pixels, 3); raises InputError for other shapes."""
    expected = [(pixels, 3)] if shape is None else [(*shape, 3), (pixels, 3)]
    if light.shape not in expected:
        swapped = shape is not None and light.shape == (*shape[::-1], 3)
        likely = "width and height are swapped" if swapped else "a picture is (height, width, channel)"
        raise InputError(f"light of shape {light.shape}, expected {' or '.join(map(str, expected))}; {likely}")
    return light.reshape(-1, 3)


def _alike(values: FloatArray, given: Light, shape: Shape | None) -> FloatArray:
    """Return a picture if `given` is a picture, else a list."""
    if given.ndim == 2:
        return values
    if shape is None:
        raise InputError("a picture for a part of T, which has no picture's size; give (pixels, 3)")
    return values.reshape(*shape, 3)


def _canonical(matrix: Csr) -> Csr:
    """Sort each row by column, and sum duplicates."""
    if not matrix.has_canonical_format:
        matrix = matrix.copy()
        matrix.sum_duplicates()
    return matrix


def _floating(weights: NDArray[np.floating]) -> NDArray[np.floating]:
    return weights.astype(np.result_type(weights.dtype, np.float32), copy=False)
