"""Inverts clusters whole: dense blocks of equal shape, batched, in float64 (thesis 5.1)."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import FloatArray, IntArray
from counterlight.maps.prior import Prior
from counterlight.tools.clusters.blocks import Batch, ClusterBlocks, Entries
from counterlight.tools.clusters.components import Clusters
from counterlight.tools.inverse.noise import cut_off
from counterlight.tools.inverse.rows import Piece, Truncation, truncated_piece
from counterlight.tools.transport.transport import CHANNELS, Csr

BATCH_VALUES = 1 << 22  # float64 values per batch of blocks (32 MiB); memory.py has the peak during work
SMALLEST_SQUARED = 1e-5  # λ/σ₁ below which TᵀT + λ²I, of condition (σ₁/λ)², would leave fewer than six digits


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
    """Blocks of P per channel for the chosen clusters; P has no ties between clusters."""

    def __init__(self, priors: tuple[Csr, ...], clusters: Clusters, chosen: NDArray[np.bool_]) -> None:
        square = replace(clusters, camera=clusters.projector, camera_sizes=clusters.projector_sizes)
        self._blocks = ClusterBlocks(square, chosen)
        self._entries: list[Entries] = [self._blocks.entries(each) for each in priors]

    def dense(self, batch: Batch) -> list[FloatArray]:
        """Return (k, n, n) blocks per channel."""
        square = Batch(batch.labels, batch.projector, batch.projector)
        return [self._blocks.dense(each, square) for each in self._entries]


def damped_inverse(
    T: FloatArray, damping: FloatArray, noise: float = 0.0, prior: FloatArray | None = None
) -> FloatArray:
    """Return regularised pseudo-inverses T⁺ = (TᵀT + P + λ²I)⁻¹Tᵀ of a batch of blocks (docs/mathematics.md 2).

    T : (…, camera pixels, projector pixels).
    damping : λ, broadcast to (…,). 0 gives Moore-Penrose by SVD, without the singular values that are noise.
    noise : noise as a share of T's entries; 0 if only rounding counts (noise.py).
    prior : P, (…, projector pixels, projector pixels). Not used if the damping is so small that the SVD is needed.

    Returns (…, projector pixels, camera pixels).
    """
    rows, columns = T.shape[-2:]
    damping = np.asarray(damping, np.float64)
    if np.any(damping**2 < SMALLEST_SQUARED**2 * np.sum(T**2, axis=(-2, -1))):
        return _by_singular_values(T, damping, noise)
    transposed = np.swapaxes(T, -1, -2)
    squared = damping[..., None, None] ** 2
    if prior is not None:
        return np.asarray(np.linalg.solve(transposed @ T + prior + squared * np.eye(columns), transposed))
    if rows < columns:  # with fewer rows than columns, Tᵀ(TTᵀ + λ²I)⁻¹ is the same matrix from a smaller system
        return np.asarray(np.swapaxes(np.linalg.solve(T @ transposed + squared * np.eye(rows), T), -1, -2))
    return np.asarray(np.linalg.solve(transposed @ T + squared * np.eye(columns), transposed))


def _by_singular_values(T: FloatArray, damping: FloatArray, noise: float) -> FloatArray:
    """Return V · diag(σ / (σ² + λ²)) · Uᵀ; without damping, only singular values above the noise count."""
    U, sigma, Vt = np.linalg.svd(T, full_matrices=False)
    floor = np.where(damping[..., None] == 0, cut_off(T, sigma[..., :1], noise), 0.0)
    gain = np.divide(sigma, sigma**2 + damping[..., None] ** 2, out=np.zeros_like(sigma), where=sigma > floor)
    return np.asarray(np.swapaxes(Vt, -1, -2) @ (gain[..., None] * np.swapaxes(U, -1, -2)))


def clustered_jobs(
    matrices: tuple[Csr, ...],
    clusters: Clusters,
    chosen: NDArray[np.bool_],
    damping: FloatArray,
    noise: float,
    truncation: Truncation,
    priors: tuple[Csr, ...] | None = None,
) -> Iterator[Callable[[], Piece]]:
    """Yield jobs that invert the chosen clusters, each job a batch of blocks of one shape.

    matrices : T for red, green and blue.
    chosen : (clusters,) bool.
    damping : λ, (3,).
    noise : noise as a share of T's entries.
    priors : P per channel, without ties between clusters.
    """
    blocks = ClusterBlocks(clusters, chosen)
    entries = [blocks.entries(T) for T in matrices]
    drawn = None if priors is None else PriorBlocks(priors, clusters, chosen)
    for batch in blocks.batches(BATCH_VALUES):
        yield partial(_invert, blocks, entries, batch, damping, noise, truncation, drawn)


def _invert(
    blocks: ClusterBlocks,
    entries: list[Entries],
    batch: Batch,
    damping: FloatArray,
    noise: float,
    truncation: Truncation,
    drawn: PriorBlocks | None,
) -> Piece:
    priors = [None] * len(entries) if drawn is None else drawn.dense(batch)
    inverses = [
        damped_inverse(blocks.dense(channel, batch), damp, noise, prior)
        for channel, damp, prior in zip(entries, damping, priors, strict=True)
    ]
    return truncated_piece(batch.projector, batch.camera, np.stack(inverses), truncation)
