"""One colour channel of T, as scipy and the dense solvers need it: vectors instead of pictures."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, aslinearoperator

from counterlight.arrays import FloatArray
from counterlight.maps.chain import Chain
from counterlight.maps.row_map import SparseRows
from counterlight.tools.clusters.components import Clusters, find_clusters
from counterlight.tools.transport.transport import (
    BlurredLight,
    Csr,
    Dense,
    FarLight,
    Transport,
    channel,
    channel_of_chain,
    stacked,
)


@dataclass(frozen=True)
class Channel:
    """T = S + B P + U M D of one channel.

    near : S, (camera pixels, projector pixels) float64, no explicit zeros.
    chains : B P and U M D, if any.
    """

    near: Csr
    chains: tuple[Chain[Csr, FloatArray | None], ...] = ()

    @classmethod
    def of(cls, T: Transport, i: int) -> "Channel":
        """Extract channel 0, 1 or 2."""
        return cls(channel(T.near, i).astype(np.float64), tuple(channel_of_chain(chain, i) for chain in T.chains))

    @property
    def shape(self) -> tuple[int, int]:
        rows, columns = self.near.shape
        return int(rows), int(columns)

    @property
    def in_entries(self) -> bool:
        """Whether all of T is near light, whose clusters are separate systems."""
        return not self.chains

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
        for chain in self.chains:
            scattered = aslinearoperator(chain.scatter)
            mixed = scattered if chain.mix is None else scattered @ aslinearoperator(chain.mix)
            near = near + mixed @ aslinearoperator(chain.gather)
        return near

    def only(self, rows: NDArray[np.bool_]) -> "Channel":
        """Return the near light of some camera pixels; the other rows are empty."""
        near = self.near.copy()
        near.data[~np.repeat(rows, np.diff(near.indptr))] = 0
        near.eliminate_zeros()
        return Channel(near)

    def alone(self) -> Transport:
        """Return this channel as a T whose other two channels are dark."""
        far = blurred = None
        for chain in self.chains:
            gather, scatter, M = _with_dark(chain.gather), _with_dark(chain.scatter), chain.mix
            if M is None:
                blurred = BlurredLight(gather, None, scatter)
            else:
                far = FarLight(gather, Dense(np.stack([M, 0 * M, 0 * M])), scatter)
        return Transport(_with_dark(self.near), far, blurred=blurred)


def _with_dark(matrix: Csr) -> SparseRows:
    return stacked([matrix, Csr(matrix.shape), Csr(matrix.shape)])
