"""Light transport as a sum of parts: near light as sparse matrices, far light as a product of three small factors.

Light that travels directly, or scatters close by, makes T sparse and sharp. Light that crosses the room reaches
everything but is smooth: stored entry by entry it would fill T, so it is kept as U M D (docs/mathematics.md 3).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

FloatArray = NDArray[np.float64]
Csr: TypeAlias = sparse.csr_array  # scipy's stubs make it generic, scipy itself does not
CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True)
class FarLight:
    """Smooth indirect light: camera radiance = scatter · mix · gather · p, for each colour channel.

    gather : D, three (cells, projector pixels) CSR matrices, irradiance that arrives directly on each surface cell.
    mix : M, (3, cells, cells), indirect irradiance on a cell per direct irradiance on another, all bounces.
    scatter : U, three (camera pixels, cells) CSR matrices, radiance seen per indirect irradiance.
    """

    gather: tuple[Csr, ...]
    mix: FloatArray
    scatter: tuple[Csr, ...]


@dataclass(frozen=True)
class Transport:
    """T of one projector and one camera, per colour channel: near[λ] + far.

    near : three CSR matrices (camera pixels, projector pixels), float32, radiance per unit drive, ≥ 0.
    """

    near: tuple[Csr, ...]
    far: FarLight | None = None

    @property
    def shape(self) -> tuple[int, int]:
        rows, columns = self.near[0].shape
        return int(rows), int(columns)

    def apply(self, drive: FloatArray) -> FloatArray:
        """T p: (projector pixels, 3) -> (camera pixels, 3); ambient light not included."""
        return np.stack([self._channel(i, drive[:, i]) for i in range(3)], axis=1)

    def apply_transpose(self, picture: FloatArray) -> FloatArray:
        """Tᵀ c: (camera pixels, 3) -> (projector pixels, 3), the dual picture (thesis eq. 3.12)."""
        return np.stack([self._channel_transpose(i, picture[:, i]) for i in range(3)], axis=1)

    def composition(self) -> FloatArray:
        """T·1, the floodlit room without ambient light: (camera pixels, 3)."""
        return self.apply(np.ones((self.shape[1], 3)))

    def _channel(self, i: int, p: FloatArray) -> FloatArray:
        near: FloatArray = self.near[i] @ p
        if self.far is None:
            return near
        far: FloatArray = self.far.scatter[i] @ (self.far.mix[i] @ (self.far.gather[i] @ p))
        return near + far

    def _channel_transpose(self, i: int, c: FloatArray) -> FloatArray:
        near: FloatArray = self.near[i].T @ c
        if self.far is None:
            return near
        far: FloatArray = self.far.gather[i].T @ (self.far.mix[i].T @ (self.far.scatter[i].T @ c))
        return near + far


def shared_pattern(
    matrices: Sequence[Csr], dtype: type[np.floating] = np.float32
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[Any]]:
    """The union of three sparsity patterns: indptr, indices and (entries, 3) weights, sorted by column in each row."""
    ones = [sparse.csr_array((np.ones(m.nnz, np.int8), m.indices, m.indptr), shape=m.shape) for m in matrices]
    union = sparse.csr_array(ones[0] + ones[1] + ones[2])
    union.sort_indices()
    columns = union.shape[1]
    rows = np.repeat(np.arange(union.shape[0], dtype=np.int64), np.diff(union.indptr))
    places = rows * columns + union.indices
    weights = np.zeros((union.nnz, 3), dtype)
    for i, matrix in enumerate(matrices):
        matrix_rows = np.repeat(np.arange(matrix.shape[0], dtype=np.int64), np.diff(matrix.indptr))
        at = np.searchsorted(places, matrix_rows * columns + matrix.indices)
        with np.errstate(over="ignore"):  # beyond float32 becomes infinity, which no map is packed with
            weights[at, i] = matrix.data
    return union.indptr.astype(np.int64), union.indices.astype(np.int64), weights
