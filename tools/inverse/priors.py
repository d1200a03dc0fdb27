"""A prior as matrices for inverses: P of each channel, without ties between clusters of T."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import FloatArray, IntArray
from counterlight.maps.prior import Prior
from counterlight.tools.clusters.blocks import Batch, ClusterBlocks, Entries
from counterlight.tools.clusters.components import Clusters
from counterlight.tools.transport.transport import CHANNELS, Csr


def prior_matrices(prior: Prior, labels: IntArray) -> tuple[Csr, ...]:
    """Return P per channel, (projector pixels, projector pixels), without ties between pixels of different labels.

    A cut tie no longer acts on either pixel: both diagonals lose it.
    """
    height, width = prior.damping.shape[:2]
    pixel = np.arange(height * width).reshape(height, width)
    first = np.concatenate([pixel[:, :-1].ravel(), pixel[:-1].ravel()])
    second = np.concatenate([pixel[:, 1:].ravel(), pixel[1:].ravel()])
    kept = labels[first] == labels[second]
    first, second = first[kept], second[kept]
    found = []
    for i in range(len(CHANNELS)):
        ties = np.concatenate([prior.right[:, :-1, i].ravel(), prior.down[:-1, :, i].ravel()]).astype(np.float64)[kept]
        couplings = Csr((-ties, (first, second)), shape=(pixel.size, pixel.size))
        couplings = Csr(couplings + couplings.T)
        diagonal = prior.damping[..., i].ravel() - couplings.sum(axis=1)
        matrix = Csr(couplings + sparse.diags_array(diagonal))
        matrix.eliminate_zeros()
        found.append(matrix)
    return tuple(found)


class PriorBlocks:
    """Blocks of P per channel for the chosen clusters; no tie crosses their borders."""

    def __init__(self, priors: tuple[Csr, ...], clusters: Clusters, chosen: NDArray[np.bool_]) -> None:
        square = replace(clusters, camera=clusters.projector, camera_sizes=clusters.projector_sizes)
        self._blocks = ClusterBlocks(square, chosen)
        self._entries: list[Entries] = [self._blocks.entries(each) for each in priors]

    def dense(self, batch: Batch) -> list[FloatArray]:
        """Return (k, n, n) blocks per channel."""
        square = Batch(batch.labels, batch.projector, batch.projector)
        return [self._blocks.dense(each, square) for each in self._entries]
