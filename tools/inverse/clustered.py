"""Clusters inverted whole: dense blocks of equal shape, batched, in float64 (thesis 5.1)."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tools.clusters.blocks import Batch, ClusterBlocks
from tools.clusters.components import Clusters
from tools.inverse.pieces import Piece, truncated_piece
from tools.transport.transport import Csr

FloatArray = NDArray[np.float64]
BATCH_VALUES = (
    1 << 22
)  # float64 values of one batch of blocks (32 MiB); a batch needs about ten times that while it runs
FLOAT32_EPS = float(np.finfo(np.float32).eps)  # T is stored in float32: singular values below σ₁ · n · eps are noise


def damped_inverse(T: FloatArray, damping: FloatArray, noise: float = 0.0) -> FloatArray:
    """Regularised pseudo-inverses T⁺ = (TᵀT + λ²I)⁻¹Tᵀ of a batch of blocks (docs/mathematics.md 2).

    T : (…, camera pixels, projector pixels).  damping : broadcast to (…,), λ itself; 0 gives Moore-Penrose by SVD.
    noise : of T's entries, relative; without damping, singular values that such noise alone would have are left out.
    Returns (…, projector pixels, camera pixels).
    """
    rows, columns = T.shape[-2:]
    if not np.any(damping):
        return _plain_inverse(T, noise)
    transposed = np.swapaxes(T, -1, -2)
    squared = np.asarray(damping)[..., None, None] ** 2
    if rows < columns:  # Tᵀ(TTᵀ + λ²I)⁻¹ is the same matrix with the smaller system to solve
        return np.asarray(np.swapaxes(np.linalg.solve(T @ transposed + squared * np.eye(rows), T), -1, -2))
    return np.asarray(np.linalg.solve(transposed @ T + squared * np.eye(columns), transposed))


def _plain_inverse(T: FloatArray, noise: float) -> FloatArray:
    """V Σ⁺ Uᵀ without the singular values that are rounding or noise.

    A random matrix of independent entries of standard deviation s has a largest singular value of about s (√m + √n)
    (Davidson and Szarek 2001); here s is `noise` times the root mean square of T's entries.
    """
    m, n = T.shape[-2:]
    U, sigma, Vt = np.linalg.svd(T, full_matrices=False)
    rms = np.sqrt(np.sum(sigma**2, axis=-1, keepdims=True) / (m * n))
    floor = np.maximum(FLOAT32_EPS * max(m, n) * sigma[..., :1], noise * rms * (np.sqrt(m) + np.sqrt(n)))
    kept = sigma > floor
    inverse = np.where(kept, 1 / np.where(kept, sigma, 1.0), 0.0)
    return np.asarray(np.swapaxes(Vt, -1, -2) @ (inverse[..., None] * np.swapaxes(U, -1, -2)))


def clustered_jobs(
    matrices: tuple[Csr, ...],
    clusters: Clusters,
    chosen: NDArray[np.bool_],
    invert: Callable[[FloatArray, int], FloatArray],
    reach: FloatArray,
    budget: float,
) -> Iterator[Callable[[], Piece]]:
    """Jobs that invert the chosen clusters, each a batch of blocks of one shape.

    matrices : T for red, green and blue.  chosen : (clusters,).
    invert : blocks (k, m, n) of a channel 0, 1 or 2 -> their inverses (k, n, m).
    """
    blocks = ClusterBlocks(clusters, chosen)
    entries = [blocks.entries(T) for T in matrices]

    def work(batch: Batch) -> Piece:
        m, n = batch.camera.shape[1], batch.projector.shape[1]
        inverses = [invert(blocks.dense(part, batch), channel).reshape(-1, m) for channel, part in enumerate(entries)]
        columns = np.repeat(batch.camera, n, axis=0)
        return truncated_piece(batch.projector.ravel(), columns, np.stack(inverses), reach, budget)

    for batch in blocks.batches(BATCH_VALUES):
        yield partial(work, batch)
