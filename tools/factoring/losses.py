"""The loss of pictures, in decibels of the camera picture, that are compensated by a factored T instead of by T.

Four pictures are sensitive to errors of far light: a photograph, a view whose right half alone is lit, spots on black,
and a soft picture, which can be shown so well that the least error is visible. p' is the best drive by the factored T',
and p the best drive by T. The loss is E(p') − E(p) in decibels, where E is the mean square of T p − b relative to white
over the camera pixels that count. To first order, the loss is at most the rise of E by the wrong light T p' − T' p'.
`Pictures.losses` estimates it for many candidates at once; `measured` measures it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray
from counterlight.pipeline.refinement import OVER_RELAXATION, momentum
from counterlight.tools.factoring import passes
from counterlight.tools.inverse.pictures import soft_picture, typical_pictures
from counterlight.tools.transport.transport import Shape, Transport

NAMES = ("photograph", "half", "spots", "soft")
SPOTS = 6  # spots along the longer side
STEPS, MORE = 80, 40
DARKEST = 1e-6  # E that counts as zero: 60 dB below white, half a code value of eight bits


@dataclass(frozen=True)
class Pictures:
    """Target pictures and their drives.

    desired : (camera pixels, 3, pictures). b, radiance.
    white : radiance of their white.
    counted : (camera pixels,) bool.
    drive : (projector pixels, 3, pictures). p'.
    """

    desired: FloatArray
    white: float
    counted: BoolArray
    drive: FloatArray

    def squared_error(self, T: Transport) -> FloatArray:
        """Returns E of each picture."""
        residual, _ = _looked_at(T, self)
        return self.relative(np.sum(residual**2, axis=0))

    def relative(self, squares: FloatArray) -> FloatArray:
        """Convert sums over the pixels that count, (…, 3, pictures), to means relative to white, (…, pictures)."""
        return np.asarray(squares.sum(axis=-2) / (3 * max(self.counted.sum(), 1) * self.white**2))

    def losses(self, squares: FloatArray, errors: FloatArray) -> FloatArray:
        """Returns the loss in dB from two inputs: Σ δ² of wrong light, (…, 3, pictures), and E of the factored T."""
        return np.asarray(10 * np.log10(1 + self.relative(squares) / (errors + DARKEST)))


def asked(transport: Transport, mask: NDArray[np.bool_]) -> Pictures:
    """Returns the pictures of a room with grey drives; mask is (camera height, camera width)."""
    grey = np.stack([picture.ravel() for picture in _drawn(mask.shape)], axis=-1)
    white = _white(transport.composition()[mask.ravel()])
    desired = np.repeat(white * grey[:, None, :], 3, axis=1)
    return Pictures(desired, white, mask.ravel(), np.full((transport.shape[1], 3, len(NAMES)), 0.5))


def _white(floodlight: FloatArray) -> float:
    """Returns the level that nine in ten pixels (n, 3) reach in every lit channel, as `reachable_white`; > 0."""
    lit = floodlight[:, floodlight.any(axis=0)]
    levels = [float(np.percentile(light, 10)) for light in (lit.min(axis=1), lit.max(axis=1))] if lit.size else []
    return next((level for level in levels if level > 0), 1.0)


def compensated(T: Transport, pictures: Pictures, steps: int = STEPS) -> Pictures:
    """Returns the pictures after some accelerated steps towards the best drives by T (pipeline/refinement.py)."""
    ones = replace(pictures, desired=0 * pictures.desired, drive=np.ones_like(pictures.drive))
    d = _looked_at(T, ones)[1]
    step_size = np.divide(1.0, d, out=np.zeros_like(d), where=d > 0)
    p = y = pictures.drive
    for step in range(1, steps + 1):
        ascent = _looked_at(T, replace(pictures, drive=y))[1]
        q = np.clip(y - step_size * ascent, 0, 1)
        y, p = q + momentum(step) * (q - p) + OVER_RELAXATION * (q - y), q
    return replace(pictures, drive=p)


def measured(T: Transport, factored: Transport, pictures: Pictures) -> dict[str, float]:
    """Returns each picture's loss in dB: MORE steps by the factored T compared with MORE steps by T, judged by T."""
    best = compensated(factored, pictures)
    by_factors, by_T = (compensated(each, best, MORE).squared_error(T) for each in (factored, T))
    found = 10 * np.log10((by_factors + DARKEST) / (by_T + DARKEST))
    return {name: max(float(loss), 0.0) for name, loss in zip(NAMES, found, strict=True)}


def _looked_at(T: Transport, pictures: Pictures) -> tuple[FloatArray, FloatArray]:
    """Returns r = T p − b where it counts, (camera pixels, 3, pictures), and Tᵀ r."""
    offset, far = -pictures.desired, T.far
    if far is not None:
        offset = offset + each_picture(far.apply, pictures.drive)
    residual, parts = passes.residual_and_back(*passes.operands(T.near), pictures.drive, offset, pictures.counted)
    back = parts.sum(axis=0)
    return residual, back if far is None else back + each_picture(far.apply_transpose, residual)


def each_picture(apply: Callable[[FloatArray], FloatArray], light: FloatArray) -> FloatArray:
    """Apply an operator on (pixels, 3) to (pixels, 3, pictures)."""
    return np.stack([apply(np.ascontiguousarray(light[..., i])) for i in range(light.shape[2])], axis=-1)


def _drawn(shape: Shape) -> tuple[FloatArray, ...]:
    """Returns grey pictures (height, width), 0 to 1, in the order of NAMES."""
    half = np.zeros(shape)
    half[:, shape[1] // 2 :] = 1
    apart = max(shape) / SPOTS
    y, x = ((np.arange(side) + 0.5) % apart - apart / 2 for side in shape)
    spots = np.where(np.hypot(y[:, None], x) < max(apart / 8, 1), 1.0, 0.0)
    return typical_pictures(shape)[0], half, spots, soft_picture(shape)
