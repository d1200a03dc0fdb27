"""Connected components of the bipartite graph camera pixels | projector pixels (thesis 4.2.1)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from counterlight.tools.transport.transport import Csr


@dataclass(frozen=True)
class Clusters:
    """A label per pixel, −1 for pixels without any connection.

    camera, projector : (pixels,) int64 labels 0 … count − 1.
    camera_sizes, projector_sizes : (count,) pixels in each cluster.
    """

    camera: NDArray[np.int64]
    projector: NDArray[np.int64]
    camera_sizes: NDArray[np.int64]
    projector_sizes: NDArray[np.int64]

    @property
    def count(self) -> int:
        return self.projector_sizes.size


def no_clusters(shape: tuple[int, int]) -> Clusters:
    """Every pixel without a label; shape : (camera pixels, projector pixels)."""
    camera, projector = (np.full(pixels, -1, np.int64) for pixels in shape)
    return Clusters(camera, projector, np.zeros(0, np.int64), np.zeros(0, np.int64))


def find_clusters(pattern: Csr) -> Clusters:
    """Label the connected components of a (camera pixels, projector pixels) matrix; unconnected pixels get none."""
    rows, columns = pattern.shape
    nodes = rows + columns
    # Links from camera to projector pixels only: the search itself follows them both ways.
    indptr = np.concatenate([pattern.indptr, np.full(columns, pattern.nnz, pattern.indptr.dtype)])
    links = np.ones(pattern.nnz), pattern.indices.astype(np.int64) + rows, indptr
    _, labels = csgraph.connected_components(sparse.csr_array(links, shape=(nodes, nodes)), directed=False)
    lit = np.concatenate([np.diff(pattern.indptr) > 0, np.bincount(pattern.indices, minlength=columns) > 0])
    kept = np.bincount(labels[lit], minlength=int(labels.max(initial=-1)) + 1) > 0
    label = np.where(lit, (np.cumsum(kept) - 1)[labels], -1).astype(np.int64, copy=False)
    camera, projector = label[:rows], label[rows:]
    count = np.count_nonzero(kept)
    sizes = [np.bincount(part[part >= 0], minlength=count).astype(np.int64) for part in (camera, projector)]
    return Clusters(camera, projector, sizes[0], sizes[1])
