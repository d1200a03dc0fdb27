"""Least squares of minimum norm by singular value decomposition (thesis 4.2.4; LAPACK's gelsd)."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.tools.solve.channel import Channel
from counterlight.tools.solve.clusterwise import Blockwise, Clusterwise

FLOAT32_EPS = float(np.finfo(np.float32).eps)  # T is stored in float32: singular values below σ₁ · n · eps are noise


def svd(T: Channel) -> Clusterwise:
    """Return a solver with p = V Σ⁺ Uᵀ b per cluster, without singular values below σ₁ · max(m, n) · 2⁻²³."""
    return Clusterwise(T, minimum_norm, "are rank-deficient (their least squares of minimum norm is taken)")


def minimum_norm(blocks: FloatArray) -> Blockwise:
    """Factorise blocks (k, m, n). A block is special if singular values were left out."""
    U, sigma, Vt = np.linalg.svd(blocks, full_matrices=False)
    kept = sigma > sigma[:, :1] * FLOAT32_EPS * max(blocks.shape[1:])

    def solve(targets: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        weights = np.where(kept, np.einsum("kmr,km->kr", U, targets), 0.0) / np.where(kept, sigma, 1.0)
        return np.einsum("krn,kr->kn", Vt, weights), ~kept.all(axis=1)

    return solve
