"""Choosing λ of T⁺ = (TᵀT + λ²I)⁻¹Tᵀ by what counts: the camera's error *after* the clamp to 0..1.

See docs/mathematics.md 2. GCV and the L-curve know nothing of the clamp, which is what makes an undamped
pseudo-inverse bad.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import lsmr

from player.command import track
from tools.inverse.pictures import typical_pictures
from tools.transport.transport import Csr

FloatArray = NDArray[np.float64]
CANDIDATES = (0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.4)
POWER_STEPS = 50
LSMR_STEPS = 60


@dataclass(frozen=True)
class DampingChoice:
    """λ as a fraction of the largest singular value, and the root mean square camera error of every candidate."""

    damping: float
    errors: dict[float, float]


def largest_singular_value(T: Csr) -> float:
    """σ₁ by power iteration on TᵀT, which is non-negative, so a start of ones cannot miss it; about 1 % accurate."""
    v = np.ones(T.shape[1])
    for _ in range(POWER_STEPS):
        w: FloatArray = np.asarray(T.T @ (T @ v))
        norm = float(np.linalg.norm(w))
        if norm == 0:
            return 0.0
        v = w / norm
    return float(np.linalg.norm(T @ v))


def choose_damping(T: Csr, white: float, mask: NDArray[np.bool_], judge: Csr | None = None) -> DampingChoice:
    """Try every candidate on the typical pictures and keep the best.

    T : (camera pixels, projector pixels), what is inverted, rows outside the mask empty.
    judge : the transport that says what the camera sees, if T is a decomposed one.  mask : (camera height, width).
    """
    inside = mask.ravel()
    targets = [np.where(inside, white * picture.ravel(), 0.0) for picture in typical_pictures(mask.shape)]
    sigma = largest_singular_value(T)
    errors: dict[float, float] = {}
    for damping in track(CANDIDATES, "choosing λ", len(CANDIDATES)):
        squares = [_clamped_error(T, T if judge is None else judge, b, damping * sigma) for b in targets]
        errors[damping] = float(np.sqrt(np.sum(squares) / (len(targets) * int(inside.sum()))))
    return DampingChoice(min(errors, key=lambda damping: errors[damping]), errors)


def _clamped_error(T: Csr, judge: Csr, b: FloatArray, damp: float) -> float:
    p = np.asarray(lsmr(T, b, damp=damp, maxiter=LSMR_STEPS, atol=1e-5, btol=1e-5)[0])
    residual: FloatArray = judge @ np.clip(p, 0, 1) - b
    return float(residual @ residual)
