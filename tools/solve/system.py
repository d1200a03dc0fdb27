"""The linear system of one colour channel, min ‖T p − b‖ over the camera pixels that count (docs/mathematics.md 1)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from counterlight.tools.clusters.components import Clusters, find_clusters
from counterlight.tools.clusters.finite import refuse_not_finite
from counterlight.tools.transport.transport import Csr, Transport

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class FarFactors:
    """Far light of one channel, U M D (tools.transport.transport.FarLight)."""

    gather: Csr
    mix: FloatArray
    scatter: Csr


@dataclass(frozen=True)
class LinearSystem:
    """min ‖T p − b‖², T = near + far.

    near : (camera pixels, projector pixels) float64, rows outside the mask empty, no explicit zeros.
    target : b, (camera pixels,), 0 outside the mask.
    far : its scatter's rows outside the mask are empty, too.
    """

    near: Csr
    target: FloatArray
    far: FarFactors | None = None

    @property
    def shape(self) -> tuple[int, int]:
        rows, columns = self.near.shape
        return int(rows), int(columns)

    @cached_property
    def clusters(self) -> Clusters:
        """Connected components of the near light."""
        return find_clusters(self.near)

    @cached_property
    def _transposed(self) -> Csr:
        """Tᵀ as rows: gathering is twice as fast as scattering."""
        return sparse.csr_array(self.near.T)

    def apply(self, p: FloatArray) -> FloatArray:
        """T p: (projector pixels,) -> (camera pixels,)."""
        seen: FloatArray = self.near @ p
        if self.far is None:
            return seen
        return np.asarray(seen + self.far.scatter @ (self.far.mix @ (self.far.gather @ p)))

    def apply_transpose(self, c: FloatArray) -> FloatArray:
        """Tᵀ c: (camera pixels,) -> (projector pixels,)."""
        dual: FloatArray = self._transposed @ c
        if self.far is None:
            return dual
        return np.asarray(dual + self.far.gather.T @ (self.far.mix.T @ (self.far.scatter.T @ c)))

    def squared_error(self, p: FloatArray) -> float:
        """‖T p − b‖²."""
        return float(np.sum((self.apply(p) - self.target) ** 2))


def linear_system(T: Csr | ArrayLike, b: ArrayLike) -> LinearSystem:
    """A system from a matrix (camera pixels, projector pixels) and b (camera pixels,).

    Raises NonFiniteError, naming the cluster, if T or b is not finite in float32; ValueError for shapes that differ.
    """
    near: Csr = sparse.csr_array(T).astype(np.float64)  # type: ignore[arg-type]
    target = np.array(b, np.float64)
    if target.shape != near.shape[:1]:
        raise ValueError(f"b has shape {target.shape}, T has {near.shape[0]} rows")
    near.eliminate_zeros()
    if max(*near.shape, near.nnz) <= np.iinfo(np.int32).max:  # half the indices to read in every product
        near.indices, near.indptr = near.indices.astype(np.int32), near.indptr.astype(np.int32)
    refuse_not_finite(near, target)
    return LinearSystem(near, target)


def channel_system(transport: Transport, channel: int, target: FloatArray, mask: NDArray[np.bool_]) -> LinearSystem:
    """The system of colour channel 0, 1 or 2; rows outside the mask neither constrain nor count.

    target : b, (camera pixels,).  mask : (camera pixels,).
    """
    system = linear_system(_rows_kept(transport.near[channel], mask), np.where(mask, target, 0.0))
    if transport.far is None:
        return system
    far = transport.far
    scatter = _rows_kept(far.scatter[channel], mask)
    return LinearSystem(system.near, system.target, FarFactors(far.gather[channel], far.mix[channel], scatter))


def _rows_kept(matrix: Csr, mask: NDArray[np.bool_]) -> Csr:
    kept = np.where(np.repeat(mask, np.diff(matrix.indptr)), matrix.data, 0)
    return sparse.csr_array((kept, matrix.indices, matrix.indptr), shape=matrix.shape)
