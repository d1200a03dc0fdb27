"""Least squares by orthogonal factorisation, QR of tall and LQ of wide clusters (thesis 4.2.4; LAPACK's gels)."""

import numpy as np
from numpy.typing import NDArray

from counterlight.tools.solve.clusterwise import solve_clusters
from counterlight.tools.solve.solution import Solution
from counterlight.tools.solve.svd import FLOAT32_EPS, minimum_norm
from counterlight.tools.solve.system import LinearSystem

FloatArray = NDArray[np.float64]


def solve_qr(system: LinearSystem) -> Solution:
    """p of each cluster that has full rank by QR or LQ; the others fall back to the SVD, and the note counts them."""
    return solve_clusters(system, _full_rank, "are rank-deficient; svd took them")


def _full_rank(blocks: FloatArray, targets: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Blocks (k, m, n), b (k, m) -> p (k, n), and whether a block went to the SVD (k,).

    R of a factorisation without pivoting shows a column that depends on those before it as a small diagonal value.
    """
    m, n = blocks.shape[1:]
    wide = m < n
    Q, R = np.linalg.qr(np.swapaxes(blocks, 1, 2) if wide else blocks)
    diagonal = np.abs(np.diagonal(R, axis1=1, axis2=2))
    deficient = diagonal.min(axis=1) <= diagonal.max(axis=1) * FLOAT32_EPS * max(m, n)
    R[deficient] = np.eye(min(m, n))
    if wide:  # T = Rᵀ Qᵀ: p = Q R⁻ᵀ b
        y = np.linalg.solve(np.swapaxes(R, 1, 2), targets[..., None])
        p = (Q @ y)[..., 0]
    else:
        p = np.linalg.solve(R, np.swapaxes(Q, 1, 2) @ targets[..., None])[..., 0]
    if deficient.any():
        p[deficient] = minimum_norm(blocks[deficient], targets[deficient])[0]
    return p, deficient
