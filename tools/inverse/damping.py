"""Chooses λ of T⁺ = (TᵀT + λ²I)⁻¹Tᵀ by the camera's error *after* the clamp to 0..1.

See docs/mathematics.md 2. GCV and the L-curve ignore the clamp, but the clamp makes an undamped pseudo-inverse bad.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.tools.inverse.bidiagonal import Products, bidiagonalise, largest_singular_value
from counterlight.tools.inverse.pictures import squares_of, typical_pictures
from counterlight.tools.jobs import run_jobs
from counterlight.tools.transport.transport import Csr

CANDIDATES = (0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.4)
MOST_STEPS = 120  # largest number of steps; 60 or 240 steps change the errors of rooms of 640x480 by at most 0.1 %
ACCURACY = 0.1 / 255  # drive; higher accuracy does not change the errors visibly
# largest number of pixels that are judged as a whole; larger pictures are judged by squares (pictures.py)
SMALL = 1 << 17


@dataclass(frozen=True)
class DampingChoice:
    """λ as a fraction of the largest singular value, and the root mean square camera error of every candidate."""

    damping: float
    errors: dict[float, float]


def choose_damping(
    T: Csr,
    white: float | FloatArray,
    mask: NDArray[np.bool_],
    judge: Csr | None = None,
    floor: float = 0.0,
    pictures: Sequence[FloatArray] | None = None,
    largest: float | None = None,
) -> DampingChoice:
    """Try every candidate on some pictures and return the best; large pictures are judged by a few squares.

    T : (camera pixels, projector pixels). The matrix to invert; rows outside the mask are empty.
    white : radiance of a white picture; (camera height, camera width) if T's rows are weighted.
    mask : (camera height, camera width) bool.
    judge : transport that predicts the camera picture, if T is a decomposed one.
    floor : noise of T as a fraction of σ₁; no candidate is smaller.
    pictures : pictures to try; None for the typical pictures.
    largest : T's σ₁, if known.
    """
    inside = mask.ravel()
    tried = typical_pictures(mask.shape) if pictures is None else pictures
    targets = [np.where(inside, (white * picture).ravel(), 0.0) for picture in tried]
    candidates = sorted({max(candidate, floor) for candidate in CANDIDATES})
    lambdas = (largest_singular_value(T) if largest is None else largest) * np.array(candidates)
    if is_large(T):
        squares = squares_of(mask, (T if judge is None else judge).nnz)
        columns = squares.columns(T if judge is None else judge)
        targets, inside = [b[squares.rows] for b in targets], inside[squares.rows]
        judge = None if judge is None else squares.compact(judge, columns).astype(np.float64)
        T = squares.compact(T, columns)
    products = Products(T)
    judged = products.T if judge is None else judge
    jobs = [partial(_clamped_errors, products, judged, b, lambdas) for b in targets]
    squared = np.sum(list(run_jobs(jobs, "choosing λ")), axis=0)
    means = np.sqrt(squared / (len(targets) * int(inside.sum())))
    errors = {candidate: float(error) for candidate, error in zip(candidates, means, strict=True)}
    return DampingChoice(min(errors, key=lambda damping: errors[damping]), errors)


def is_large(T: Csr) -> bool:
    """Whether only squares are judged."""
    return max(T.shape) > SMALL


def _clamped_errors(products: Products, judge: Csr, b: FloatArray, lambdas: FloatArray) -> FloatArray:
    """Return ‖T clamp(p) − b‖² for the damped solution p of each λ, (len(lambdas),)."""
    drives = bidiagonalise(products, b, lambdas, MOST_STEPS, ACCURACY).damped(lambdas)
    residual: FloatArray = judge @ np.clip(drives, 0, 1) - b[:, None]
    return np.asarray(np.sum(residual**2, axis=0))
