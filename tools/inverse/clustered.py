"""Clusters inverted whole: dense blocks of equal shape, batched, in float64 (thesis 5.1)."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tools.clusters.components import Clusters
from tools.inverse.pieces import Piece, truncated_piece
from tools.transport.transport import Csr

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BATCH_VALUES = (
    1 << 22
)  # float64 values of one batch of blocks (32 MiB); a batch needs about ten times that while it runs
FLOAT32_EPS = float(np.finfo(np.float32).eps)  # T is stored in float32: singular values below σ₁ · n · eps are noise


def damped_inverse(T: FloatArray, damping: FloatArray) -> FloatArray:
    """Regularised pseudo-inverses T⁺ = (TᵀT + λ²I)⁻¹Tᵀ of a batch of blocks (docs/mathematics.md 2).

    T : (…, camera pixels, projector pixels).  damping : broadcast to (…,), λ itself; 0 gives Moore-Penrose by SVD.
    Returns (…, projector pixels, camera pixels).
    """
    rows, columns = T.shape[-2:]
    if not np.any(damping):
        return np.asarray(np.linalg.pinv(T, rcond=FLOAT32_EPS * max(rows, columns)), np.float64)
    transposed = np.swapaxes(T, -1, -2)
    squared = np.asarray(damping)[..., None, None] ** 2
    if rows < columns:  # Tᵀ(TTᵀ + λ²I)⁻¹ is the same matrix with the smaller system to solve
        return np.asarray(np.swapaxes(np.linalg.solve(T @ transposed + squared * np.eye(rows), T), -1, -2))
    return np.asarray(np.linalg.solve(transposed @ T + squared * np.eye(columns), transposed))


def clustered_jobs(
    matrices: tuple[Csr, ...],
    clusters: Clusters,
    chosen: NDArray[np.bool_],
    damping: FloatArray,
    reach: FloatArray,
    budget: float,
) -> Iterator[Callable[[], Piece]]:
    """Jobs that invert the chosen clusters, each a batch of blocks of one shape.

    matrices : T for red, green and blue.  chosen : (clusters,).  damping : (3,) λ.
    """
    camera_order, camera_start, camera_place = _places(clusters.camera, clusters.count)
    projector_order, projector_start, projector_place = _places(clusters.projector, clusters.count)
    entries = [_entries_by_cluster(T, clusters, chosen) for T in matrices]
    shapes = np.stack([clusters.camera_sizes, clusters.projector_sizes], axis=1)[chosen]
    labels = np.flatnonzero(chosen)
    for m, n in np.unique(shapes, axis=0):
        of_shape = labels[(shapes == (m, n)).all(axis=1)]
        for batch in np.array_split(of_shape, max(1, -(-of_shape.size * int(m * n) // BATCH_VALUES))):
            columns = camera_order[camera_start[batch][:, None] + np.arange(m)]
            rows = projector_order[projector_start[batch][:, None] + np.arange(n)]
            places = camera_place, projector_place
            yield partial(_invert, entries, batch, rows, columns, places, damping, reach, budget)


def _invert(
    entries: list[tuple[IntArray, IntArray, IntArray, FloatArray]],
    batch: IntArray,
    rows: IntArray,
    columns: IntArray,
    places: tuple[IntArray, IntArray],
    damping: FloatArray,
    reach: FloatArray,
    budget: float,
) -> Piece:
    shape = batch.size, columns.shape[1], rows.shape[1]
    inverses = []
    for channel, (starts, camera, projector, values) in enumerate(entries):
        lengths = starts[batch + 1] - starts[batch]
        at = np.repeat(starts[batch] - np.cumsum(lengths) + lengths, lengths) + np.arange(lengths.sum())
        blocks = np.zeros(shape)
        blocks[np.repeat(np.arange(batch.size), lengths), places[0][camera[at]], places[1][projector[at]]] = values[at]
        inverses.append(damped_inverse(blocks, damping[channel]).reshape(-1, shape[1]))
    return truncated_piece(rows.ravel(), np.repeat(columns, shape[2], axis=0), np.stack(inverses), reach, budget)


def _places(labels: IntArray, count: int) -> tuple[IntArray, IntArray, IntArray]:
    """Pixels sorted by cluster, where each cluster starts in that order, and each pixel's place within its cluster."""
    order = np.argsort(labels, kind="stable")
    order = order[np.searchsorted(labels[order], 0) :]
    start = np.searchsorted(labels[order], np.arange(count))
    place = np.zeros(labels.size, np.int64)
    place[order] = np.arange(order.size) - start[labels[order]]
    return order, start, place


def _entries_by_cluster(
    T: Csr, clusters: Clusters, chosen: NDArray[np.bool_]
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """T's entries sorted by cluster: (clusters + 1,) starts, and per entry its camera pixel, projector pixel, value."""
    camera = np.repeat(np.arange(T.shape[0]), np.diff(T.indptr))
    labels = clusters.camera[camera]
    order = np.argsort(labels, kind="stable")
    order = order[chosen[labels[order]]]
    starts = np.searchsorted(labels[order], np.arange(clusters.count + 1))
    return starts, camera[order], T.indices[order].astype(np.int64), T.data[order].astype(np.float64)
