"""Codes for multiplexed light: S-matrices (Schechner, Nayar and Belhumeur 2003, A theory of multiplexed illumination).

Each of n pictures lights half of n sources, and a linear system separates the sources. If the camera's noise does not
grow with the light, the result has 4/n of the variance of lighting each source alone.
"""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray


def code_length(sources: int) -> int:
    """Returns the order of the S-matrix for so many sources: the least prime 4 m − 1 that is at least `sources`."""
    n = max(sources, 3)
    while n % 4 != 3 or any(n % d == 0 for d in range(3, int(n**0.5) + 1, 2)):
        n += 1
    return n


def s_matrix(n: int) -> NDArray[np.bool_]:
    """Returns the S-matrix (n, n) for n = `code_length(…)`; row i selects the (n + 1)/2 sources that picture i lights.

    The matrix is cyclic: source j is lit in picture i if i + j is 0 or a quadratic residue modulo n (Harwit and Sloane
    1979).
    """
    residue = np.zeros(n, np.bool_)
    residue[np.arange(n, dtype=np.int64) ** 2 % n] = True
    return np.asarray(residue[(np.arange(n)[:, None] + np.arange(n)) % n])


def s_inverse(n: int) -> FloatArray:
    """Returns S⁻¹ = 2 / (n + 1) · (2 Sᵀ − 1), (n, n)."""
    return np.asarray(2 / (n + 1) * (2.0 * s_matrix(n).T - 1), np.float64)
