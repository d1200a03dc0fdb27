"""Measure a projector's colour processing, with full pictures of one colour each.

Primary l of codes c gives r_l(c_l) B_l(c) of its light at full drive alone. The ramps give r. B_l of a primary alone is
1. Colours of two or three primaries at LEVELS codes each give B at the other samples. Least squares with a prior of
small second differences fit B, because a camera's gain may wander. B is then divided by its value at white, where T
is measured.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.processing import LEVELS, LIMITS, Processing
from counterlight.tools.acquisition.plan import REPEATS, Codes, LazyPatterns, Level, Reference
from counterlight.tools.acquisition.ramps import Primaries, ProjectorLight

BENT = 0.03  # usual second difference of B between neighbouring samples
ALIKE = 0.1  # usual difference of B between codes of the own primary
MODEL = 0.002  # least error assumed of a measured B
STEPS = np.rint(np.linspace(0, 255, LEVELS)).astype(np.uint8)
# level of each primary in each sample
SAMPLES = np.stack(np.meshgrid(*[np.arange(LEVELS)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
SHOWN = np.flatnonzero(np.count_nonzero(SAMPLES, axis=1) > 1)


def colour_level(projector: tuple[int, int]) -> Level:
    """Returns the level of pictures that show colours made of two or three primaries."""

    def paint(number: int) -> Codes:
        return np.full((*projector, 3), STEPS[SAMPLES[SHOWN[number]]], np.uint8)

    return Level("colour processing", LazyPatterns(len(SHOWN), paint))


def measure_processing(
    captures: Sequence[NDArray[np.floating]], room: Reference, light: ProjectorLight, spread: FloatArray
) -> tuple[Processing, NDArray[np.float32]]:
    """Fit B to the captures of `colour_level`.

    spread : (3,). Standard deviation of a capture's gain, per channel.

    Returns B, and the light of each primary in white, as ProjectorLight.primaries.
    """
    parts = Primaries(room, [each.astype(np.float64) for each in light.primaries.reshape(3, -1, 3)])
    own = light.response.curves(STEPS[:, None].repeat(3, axis=1) / 255.0)  # (LEVELS, 3)
    shares = np.stack([parts.shares(room.above_black(capture)) for capture in captures])
    whites = parts.shares(room.light)
    found = np.ones((len(SAMPLES), 3))
    for k in range(3):
        levels = SAMPLES[SHOWN, k]
        measured, steps = np.ones(len(SAMPLES)), own[SAMPLES[:, k], k]
        measured[SHOWN] = np.divide(shares[:, k], own[levels, k], out=np.ones(len(SHOWN)), where=levels > 0)
        variance = np.square(light.noise / np.maximum(steps, own[1, k])) + MODEL**2 + float(spread.max()) ** 2
        variance[-1] /= REPEATS
        measured[-1] = whites[k]
        found[:, k] = _fitted(measured, np.where(SAMPLES[:, k] > 0, 1 / variance, 0), k)
    factors = np.clip(found / found[-1], *LIMITS)
    in_white = light.primaries * found[-1].astype(np.float32)[:, None, None, None]
    return Processing(tuple(tuple(float(value) for value in row) for row in factors)), in_white


def _fitted(measured: FloatArray, weights: FloatArray, own: int) -> FloatArray:
    """Returns B of one primary at SAMPLES: weighted least squares with the prior."""
    bends = np.diff(np.eye(LEVELS), 2, axis=0) / BENT
    rows = [_along(axis, bends) for axis in range(3)] + [_along(own, np.diff(np.eye(LEVELS), axis=0) / ALIKE)]
    prior = np.concatenate(rows)
    return np.asarray(np.linalg.solve(prior.T @ prior + np.diag(weights), weights * measured))


def _along(axis: int, differences: FloatArray) -> FloatArray:
    """Returns the matrix that applies differences along an axis of the samples."""
    each = [np.eye(LEVELS)] * 3
    each[axis] = differences
    return np.kron(np.kron(each[0], each[1]), each[2])
