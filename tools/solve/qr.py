"""Least squares by orthogonal factorisation, QR of tall and LQ of wide clusters (thesis 4.2.4; LAPACK's gels)."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.tools.solve.channel import Channel
from counterlight.tools.solve.clusterwise import Blockwise, Clusterwise
from counterlight.tools.solve.svd import FLOAT32_EPS, minimum_norm


def qr(T: Channel) -> Clusterwise:
    """Return a solver by QR or LQ for clusters of full rank. The SVD solves the others; the note counts them."""
    return Clusterwise(T, _full_rank, "are rank-deficient; svd took them")


def _full_rank(blocks: FloatArray) -> Blockwise:
    """Factorise blocks (k, m, n).

    In R without pivoting, a column that depends on earlier columns shows as a small diagonal value.
    """
    m, n = blocks.shape[1:]
    wide = m < n
    Q, R = np.linalg.qr(np.swapaxes(blocks, 1, 2) if wide else blocks)
    diagonal = np.abs(np.diagonal(R, axis1=1, axis2=2))
    deficient = diagonal.min(axis=1) <= diagonal.max(axis=1) * FLOAT32_EPS * max(m, n)
    R[deficient] = np.eye(min(m, n))
    fallback = minimum_norm(blocks[deficient]) if deficient.any() else None

    def solve(targets: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        if wide:  # T = Rᵀ Qᵀ: p = Q R⁻ᵀ b
            p = (Q @ np.linalg.solve(np.swapaxes(R, 1, 2), targets[..., None]))[..., 0]
        else:
            p = np.linalg.solve(R, np.swapaxes(Q, 1, 2) @ targets[..., None])[..., 0]
        if fallback is not None:
            p[deficient] = fallback(targets[deficient])[0]
        return p, deficient

    return solve
