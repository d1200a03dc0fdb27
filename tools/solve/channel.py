"""One colour channel of T, as scipy and the dense solvers need it: vectors instead of pictures."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, aslinearoperator

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.clusters.components import Clusters, find_clusters
from counterlight.tools.transport.blurred import BlurredLight
from counterlight.tools.transport.transport import Csr, FarLight, Transport, channel, stacked


@dataclass(frozen=True)
class Channel:
    """T = S + B P + U M D of one channel.

    near : S, (camera pixels, projector pixels) float64, no explicit zeros.
    far : D, M and U.
    blurred : P and B.
    """

    near: Csr
    far: tuple[Csr, FloatArray, Csr] | None = None
    blurred: tuple[Csr, Csr] | None = None

    @classmethod
    def of(cls, T: Transport, i: int) -> "Channel":
        """Extract channel 0, 1 or 2."""
        near, far, blurred = channel(T.near, i).astype(np.float64), T.far, T.blurred
        return cls(
            near,
            None if far is None else (channel(far.gather, i), far.mix[i], channel(far.scatter, i)),
            None if blurred is None else (channel(blurred.gather, i), channel(blurred.scatter, i)),
        )

    @property
    def shape(self) -> tuple[int, int]:
        rows, columns = self.near.shape
        return int(rows), int(columns)

    @property
    def in_entries(self) -> bool:
        """Whether all of T is near light, whose clusters are separate systems."""
        return self.far is None and self.blurred is None

    @cached_property
    def clusters(self) -> Clusters:
        """Connected components of the near light."""
        return find_clusters(self.near)

    @cached_property
    def operator(self) -> LinearOperator:
        """T and Tᵀ on vectors."""
        transposed = Csr(self.near.T)  # by rows: gathering is twice as fast as scattering
        near: LinearOperator = LinearOperator(
            self.shape, matvec=self.near.dot, rmatvec=transposed.dot, dtype=np.float64
        )
        if self.blurred is not None:
            P, B = (aslinearoperator(factor) for factor in self.blurred)
            near = near + B @ P
        if self.far is None:
            return near
        D, M, U = (aslinearoperator(factor) for factor in self.far)
        return near + U @ M @ D

    def only(self, rows: NDArray[np.bool_]) -> "Channel":
        """Return the near light of some camera pixels; the other rows are empty."""
        near = self.near.copy()
        near.data[~np.repeat(rows, np.diff(near.indptr))] = 0
        near.eliminate_zeros()
        return Channel(near)

    def alone(self) -> Transport:
        """Return this channel as a T whose other two channels are dark."""
        far = blurred = None
        if self.far is not None:
            D, M, U = self.far
            far = FarLight(_beside_dark(D), np.stack([M, 0 * M, 0 * M]), _beside_dark(U))
        if self.blurred is not None:
            P, B = self.blurred
            blurred = BlurredLight(stacked([P] * 3), _beside_dark(B))
        return Transport(_beside_dark(self.near), far, blurred=blurred)


def _beside_dark(matrix: Csr) -> SparseRows:
    return stacked([matrix, Csr(matrix.shape), Csr(matrix.shape)])
