"""Clusters as dense blocks, batched by equal shape for numpy's batched linear algebra."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.clusters.components import Clusters
from counterlight.tools.transport.transport import Csr


@dataclass(frozen=True)
class Batch:
    """Clusters of one shape: their labels (k,), camera pixels (k, m) and projector pixels (k, n)."""

    labels: IntArray
    camera: IntArray
    projector: IntArray


@dataclass(frozen=True)
class Entries:
    """A matrix's entries sorted by cluster; `start`, (clusters + 1,), says where the entries of each cluster begin."""

    start: IntArray
    camera: IntArray
    projector: IntArray
    values: FloatArray


class ClusterBlocks:
    """The chosen clusters of a matrix, or of several matrices with the same clusters."""

    def __init__(self, clusters: Clusters, chosen: NDArray[np.bool_]) -> None:
        """Arrange the clusters for which `chosen`, (clusters,) bool, is True."""
        self._clusters, self._chosen = clusters, chosen
        self._camera = _Places(clusters.camera, clusters.count)
        self._projector = _Places(clusters.projector, clusters.count)

    def batches(self, batch_values: int) -> Iterator[Batch]:
        """Yield every chosen cluster once. A batch has at most about `batch_values` values, or one cluster."""
        labels = np.flatnonzero(self._chosen)
        shapes = self._clusters.camera_sizes[labels], self._clusters.projector_sizes[labels]
        labels = labels[np.lexsort(shapes[::-1])]
        sizes = np.stack([self._clusters.camera_sizes[labels], self._clusters.projector_sizes[labels]], axis=1)
        changes = np.flatnonzero((np.diff(sizes, axis=0) != 0).any(axis=1)) + 1
        for of_shape in np.split(labels, changes) if labels.size else ():
            m, n = int(self._clusters.camera_sizes[of_shape[0]]), int(self._clusters.projector_sizes[of_shape[0]])
            for batch in np.array_split(of_shape, max(1, -(-of_shape.size * m * n // batch_values))):
                if batch.size:
                    yield Batch(batch, self._camera.pixels(batch, m), self._projector.pixels(batch, n))

    def entries(self, T: Csr) -> Entries:
        """Return the entries of T in the chosen clusters. T : (camera pixels, projector pixels)."""
        camera = np.repeat(np.arange(T.shape[0]), np.diff(T.indptr))
        labels = self._clusters.camera[camera]
        order = np.argsort(labels, kind="stable")
        order = order[(labels[order] >= 0) & self._chosen[labels[order]]]
        start = np.searchsorted(labels[order], np.arange(self._clusters.count + 1))
        projector = T.indices[order].astype(np.int64)
        return Entries(start, camera[order], projector, T.data[order].astype(np.float64))

    def dense(self, entries: Entries, batch: Batch) -> FloatArray:
        """Return the batch's blocks, (k, m, n) float64."""
        first = entries.start[batch.labels]
        lengths = entries.start[batch.labels + 1] - first
        at = np.repeat(first - np.cumsum(lengths) + lengths, lengths) + np.arange(lengths.sum())
        blocks = np.zeros((*batch.camera.shape, batch.projector.shape[1]))
        places = self._camera.place[entries.camera[at]], self._projector.place[entries.projector[at]]
        blocks[np.repeat(np.arange(batch.labels.size), lengths), *places] = entries.values[at]
        return blocks


class _Places:
    """Pixels sorted by cluster, and each pixel's place within its cluster."""

    def __init__(self, labels: IntArray, count: int) -> None:
        order = np.argsort(labels, kind="stable")
        self._order: IntArray = order[np.searchsorted(labels[order], 0) :]
        self._start = np.searchsorted(labels[self._order], np.arange(count))
        self.place: IntArray = np.zeros(labels.size, np.int64)
        self.place[self._order] = np.arange(self._order.size) - self._start[labels[self._order]]

    def pixels(self, labels: IntArray, size: int) -> IntArray:
        """Return pixels (k, size) of clusters (k,) that all have `size`."""
        pixels: IntArray = self._order[self._start[labels][:, None] + np.arange(size)]
        return pixels
