"""Noise of T: singular values that noise alone could produce are not inverted.

By Weyl, noise N moves a singular value of T by at most ‖N‖. For independent noise of a share s of each entry, ‖N‖ is
about s (largest norm of a row of T + largest norm of a column). It rarely exceeds this by more than 3 s (the largest
entry) (Davidson and Szarek 2001 for full matrices, Bandeira and van Handel 2016 for any). Smaller singular values are
noise, and inversion would amplify them most. A calibration does not store s. Its smallest weight does not reveal s
either: exact sparse matrices have large weights, and direct mapping has one weight per row. Unless the caller knows s,
only the rounding of T counts.
"""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.transport.transport import Csr

FLOAT32_EPS = float(np.finfo(np.float32).eps)  # T is stored in float32
TAIL = 3.0  # limit of ‖N‖, in standard deviations above its mean


def cut_off(T: FloatArray, largest: FloatArray, noise: float) -> FloatArray:
    """Return the limit below which singular values are noise: float32 rounding σ₁ · max(m, n) · 2⁻²³, or ‖N‖ if larger.

    T : (…, m, n). Blocks.
    largest : (…, 1). Their σ₁.
    noise : s.

    Returns (…, 1).
    """
    rounding = largest * FLOAT32_EPS * max(T.shape[-2:])
    if not noise:
        return np.asarray(rounding, np.float64)
    squared = T**2
    row, column = (np.sqrt(squared.sum(axis=axis).max(axis=-1)) for axis in (-1, -2))
    return np.asarray(np.maximum(rounding, noise_norm(noise, row, column, T.max(axis=(-2, -1)))[..., None]))


def noise_of_matrix(T: Csr, noise: float) -> float:
    """Return ‖N‖ of a sparse matrix."""
    squared = T.astype(np.float64) ** 2
    row, column = (np.sqrt(squared.sum(axis=axis).max(initial=0)) for axis in (1, 0))
    return float(noise_norm(noise, row, column, T.data.max(initial=0)))


def noise_norm(noise: float, row: FloatArray, column: FloatArray, entry: FloatArray) -> FloatArray:
    """Return s (row + column + 3 entry). row, column, entry : largest row norm, column norm and entry of T ≥ 0."""
    return np.asarray(noise * (row + column + TAIL * entry))
