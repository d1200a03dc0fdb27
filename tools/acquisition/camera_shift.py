"""Detect a moved camera, projector or scene from two pictures of the floodlit room, and measure how far a camera moved.

Texture moves only with the camera. A projector that has moved lights the same paint, so the floodlit room inside the
raster does not change. Both pictures are divided by their surroundings. d in after(x) = before(x + d) is found as in
registration.py.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from counterlight.arrays import BoolArray, FloatArray
from counterlight.errors import InputError
from counterlight.pipeline.drift import sampled
from counterlight.tools.acquisition.plan import Noise
from counterlight.tools.acquisition.registration import best_shift, cauchy_weights, correlated, robust_scale

SURROUNDINGS = 4.0  # σ in camera pixels of the blur; smoother structure may come from light instead of paint
STEPS, STILL = 15, 1e-4
LEAST_SCALE = 1e-9
FARTHEST = 8  # whole-pixel shifts are searched up to 1/FARTHEST of a side
FAINT = 1e-3  # least divisor of light, as a share of the brightest light
MOST_MOVED, MOST_DIMMED = 0.03, 0.05  # allowed relative changes: of the floodlit room, and of its brightness


@dataclass(frozen=True)
class CameraShift:
    """The shift of the camera in its pixels, right and down, with its uncertainty.

    unsure : standard deviation of the shift, camera pixels.
    explained : share of the floodlit room's change that the shift explains, 0 to 1.
    change : RMS change of the floodlit room, relative to its light.
    """

    right: float
    down: float
    unsure: float
    explained: float
    change: float

    @property
    def far(self) -> float:
        return float(np.hypot(self.right, self.down))


def camera_shift(before: FloatArray, after: FloatArray, counts: BoolArray) -> CameraShift:
    """Fit the shift between two pictures of the floodlit room.

    before, after : (camera height, camera width). Light.
    counts : (camera height, camera width) bool. Pixels to use.
    """
    old, new = (_relative(light, counts) for light in (before, after))
    still = _descend(old, new, counts, np.zeros(2))
    whole = best_shift(correlated(old, new, FARTHEST, -np.inf))
    found = min(still, _descend(old, new, counts, whole), key=lambda each: each[1])
    d, cost, unsure = found
    unmoved = _cost(_residual(old, new, counts, np.zeros(2))[0])
    return CameraShift(
        float(d[0]), float(d[1]), unsure, max(1 - cost / max(unmoved, 1e-30), 0.0), float(np.sqrt(unmoved))
    )


def _relative(light: FloatArray, counts: BoolArray) -> FloatArray:
    """Returns light over the light of its surroundings, minus 1; 0 outside `counts`."""
    floor = FAINT * max(float(light[counts].max()), 1e-30)
    return np.where(counts, light / np.maximum(mean_around(light, counts, SURROUNDINGS), floor) - 1, 0)


def mean_around(values: FloatArray, counts: BoolArray, sigma: float) -> FloatArray:
    """Returns the mean of the counted values around each pixel, weighted by a Gaussian.

    values, counts : (height, width) or (height, width, channels).
    sigma : pixels.
    """
    weight, total = (
        ndimage.gaussian_filter(each, sigma, axes=(0, 1))
        for each in (counts.astype(np.float64), np.where(counts, values, 0))
    )
    return np.asarray(total / np.maximum(weight, 1e-6))


def _descend(old: FloatArray, new: FloatArray, counts: BoolArray, d: FloatArray) -> tuple[FloatArray, float, float]:
    """Refine d by Gauss-Newton steps; returns d, its cost and its standard deviation."""
    spread: FloatArray = np.eye(2)
    down, right = np.gradient(old)
    slopes = np.stack([right, down], axis=2)
    for _ in range(STEPS):
        residual, at = _residual(old, new, counts, d)
        scale = robust_scale(residual, LEAST_SCALE)
        weights = cauchy_weights(residual, scale)
        J = sampled(slopes, at)
        inverse = np.asarray(np.linalg.pinv(J.T @ (weights[:, None] * J), hermitian=True))
        step = np.clip(inverse @ (J.T @ (weights * residual)), -1, 1)
        d, spread = d + step, scale**2 * inverse
        if np.abs(step).max() < STILL:
            break
    return d, _cost(_residual(old, new, counts, d)[0]), float(np.sqrt(np.trace(spread)))


def _residual(old: FloatArray, new: FloatArray, counts: BoolArray, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns after(x) − before(x + d) of the pixels that count, (pixels,), and the places x + d, (pixels, 2)."""
    y, x = np.nonzero(counts)
    at = np.column_stack([x, y]) + 0.5 + d
    return new[counts] - sampled(old[..., None], at)[:, 0], at


def _cost(residual: FloatArray) -> float:
    """Returns the mean square without the largest tenth, so that a moved object does not count as a moved camera."""
    squares: NDArray[np.float64] = np.sort(residual**2)
    return float(squares[: max(len(squares) * 9 // 10, 1)].mean())


def refuse_moved(before: FloatArray, after: FloatArray, noise: Noise, captures: float, advice: str) -> None:
    """Raises InputError if the floodlit room changes by more than noise explains, or changes its brightness.

    before, after : (pixels, 3). Light above black.
    captures : Σ 1/n over the two pictures, each the mean of n captures.
    advice : what to do; follows a semicolon in the message.
    """
    gain = float(np.sum(before * after) / np.sum(before * before))
    change = float(np.sqrt(np.sum((after - gain * before) ** 2) / np.sum(before**2)))
    by_noise = float(np.sqrt(captures * np.sum(noise.sigma(before) ** 2) / np.sum(before**2)))
    if change > MOST_MOVED + 2 * by_noise:
        raise InputError(
            f"the floodlit room now differs by {100 * change:.1f} % from what it was at first (noise alone: "
            f"{100 * by_noise:.1f} %): camera, projector or scene moved; {advice}"
        )
    if abs(gain - 1) > MOST_DIMMED:
        raise InputError(
            f"the floodlit room is now {100 * gain:.0f} % as bright as at first: lamp or exposure changed; let "
            f"the lamp warm up, lock the exposure; {advice}"
        )
