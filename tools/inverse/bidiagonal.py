"""One Krylov basis that serves every λ: T V = U B, B lower bidiagonal (Golub and Kahan 1965).

The damped least squares min ‖T p − b‖² + λ² ‖p‖² over p = V y is min ‖B y − β₁ e₁‖² + λ² ‖y‖² for every λ (O'Leary and
Simmons 1981; Paige and Saunders 1982, whose LSQR finds the same p for one λ). The small B has an SVD in milliseconds,
so only the products with T and Tᵀ are expensive, and they are computed once. The basis is not reorthogonalised: as in
LSQR, lost orthogonality delays convergence but does not spoil it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.tools.jobs import side_by_side
from counterlight.tools.transport.transport import Csr

CHECK_EVERY = 10
SIGMA_STEPS = 20
EXHAUSTED = 1e-14  # share of the first α; after a smaller α, b and T span no further direction


class Products:
    """T and Tᵀ in float64, or in `dtype`, both by rows, because gathering is twice as fast as scattering."""

    def __init__(self, T: Csr, dtype: type = np.float64) -> None:
        self.T: Csr = T.astype(dtype)
        self.T_transposed = sparse.csr_array(self.T.T)


@dataclass(frozen=True)
class Bidiagonal:
    """V, B and β₁ after k steps, and the coefficients of the next step.

    basis : (k, projector pixels) float32. Rows of Vᵀ.
    diagonal : (k + 1,). α₁ … α_k+1.
    below : (k,). β₂ … β_k+1.
    start : β₁ = ‖b‖.
    """

    basis: NDArray[np.float32]
    diagonal: FloatArray
    below: FloatArray
    start: float

    def largest_singular_value(self) -> float:
        """Return an estimate of T's σ₁ from below; close after a few steps."""
        return float(np.linalg.norm(self._small(), 2)) if self.below.size else 0.0

    def damped(self, lambdas: FloatArray) -> FloatArray:
        """Return the damped solutions, (projector pixels, len(lambdas)), with float32 accuracy."""
        return np.asarray(self.basis.T @ self._coordinates(lambdas).astype(np.float32), np.float64)

    def errors(self, lambdas: FloatArray) -> FloatArray:
        """Return bounds on the root mean square distance of `damped` from the true minima, (len(lambdas),), for λ > 0.

        Tᵀ(b − T p) − λ² p = −α_k+1 β_k+1 y_k v_k+1, and the normal matrix has no eigenvalue below λ².
        """
        last = self._coordinates(lambdas)[-1] if self.below.size else np.zeros(lambdas.size)
        residual = self.diagonal[-1] * self.below[-1] * np.abs(last) if self.below.size else last
        return np.asarray(residual / (lambdas**2 * np.sqrt(self.basis.shape[1])))

    def _small(self) -> FloatArray:
        """Return B, (k + 1, k)."""
        k = self.below.size
        B = np.zeros((k + 1, k))
        B[np.arange(k), np.arange(k)], B[np.arange(k) + 1, np.arange(k)] = self.diagonal[:k], self.below
        return B

    def _coordinates(self, lambdas: FloatArray) -> FloatArray:
        """Return y for each λ, (k, len(lambdas)); one SVD of B serves all."""
        P, sigma, Qt = np.linalg.svd(self._small(), full_matrices=False)
        gain = sigma[:, None] / (sigma[:, None] ** 2 + lambdas**2)
        return np.asarray(Qt.T @ (gain * (self.start * P[0])[:, None]))


def bidiagonalise(
    products: Products, b: NDArray[np.floating], lambdas: FloatArray, most_steps: int, accuracy: float
) -> Bidiagonal:
    """Make steps from b until every λ > 0 is solved to `accuracy` (root mean square drive), at most `most_steps`.

    b : (camera pixels,).
    """
    T, T_transposed = products.T, products.T_transposed
    basis = np.empty((most_steps, T.shape[1]), np.float32)
    alphas, betas = list[float](), list[float]()
    u, start = _normalised(b)
    v, alpha = _normalised(T_transposed @ u)
    alphas.append(alpha)
    while len(betas) < most_steps and alphas[-1] > EXHAUSTED * alphas[0]:
        basis[len(betas)] = v
        u, beta = _normalised(T @ v - alphas[-1] * u)
        v, alpha = _normalised(T_transposed @ u - beta * v)
        betas.append(beta)
        alphas.append(alpha)
        if len(betas) % CHECK_EVERY == 0:
            found = Bidiagonal(basis[: len(betas)], np.array(alphas), np.array(betas), start)
            if lambdas.size and np.max(found.errors(lambdas)) <= accuracy:
                return found
    return Bidiagonal(basis[: len(betas)], np.array(alphas), np.array(betas), start)


def bytes_of_basis(most_steps: int, projector_pixels: int) -> int:
    """Return the bytes of a basis."""
    return most_steps * projector_pixels * np.dtype(np.float32).itemsize


def largest_singular_value(T: Csr) -> float:
    """Return σ₁, to 1 % or better, from 20 steps starting at T·1.

    T ≥ 0, so the start always contains the leading singular vector. Uses float32, which halves the bytes of every
    product.
    """
    products = Products(T, np.float32)
    start = products.T @ np.ones(T.shape[1], np.float32)
    return bidiagonalise(products, start, np.empty(0), SIGMA_STEPS, 0.0).largest_singular_value()


def largest_singular_values(matrices: Sequence[Csr]) -> FloatArray:
    """Return σ₁ of each matrix, computed in parallel."""
    return np.array(side_by_side(largest_singular_value, matrices))


def _normalised(vector: NDArray[np.floating]) -> tuple[NDArray[np.floating], float]:
    norm = float(np.sqrt(np.einsum("i,i", vector, vector, dtype=np.float64)))
    return (vector / norm if norm else vector), norm
