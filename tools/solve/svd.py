"""Least squares of minimum norm by singular value decomposition (thesis 4.2.4; LAPACK's gelsd)."""

import numpy as np
from numpy.typing import NDArray

from counterlight.tools.solve.clusterwise import solve_clusters
from counterlight.tools.solve.solution import Solution
from counterlight.tools.solve.system import LinearSystem

FloatArray = NDArray[np.float64]
FLOAT32_EPS = float(np.finfo(np.float32).eps)  # T is stored in float32: singular values below σ₁ · n · eps are noise


def solve_svd(system: LinearSystem) -> Solution:
    """p = V Σ⁺ Uᵀ b per cluster, singular values below σ₁ · max(m, n) · 2⁻²³ left out."""
    return solve_clusters(system, minimum_norm, "are rank-deficient (their least squares of minimum norm is taken)")


def minimum_norm(blocks: FloatArray, targets: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Blocks (k, m, n), b (k, m) -> p (k, n), and whether singular values were left out (k,)."""
    U, sigma, Vt = np.linalg.svd(blocks, full_matrices=False)
    kept = sigma > sigma[:, :1] * FLOAT32_EPS * max(blocks.shape[1:])
    weights = np.where(kept, np.einsum("kmr,km->kr", U, targets), 0.0) / np.where(kept, sigma, 1.0)
    return np.einsum("krn,kr->kn", Vt, weights), ~kept.all(axis=1)
