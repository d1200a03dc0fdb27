"""Black, the three primaries and the camera's noise, from one picture each or, with white, from several."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from counterlight.arrays import BoolArray, FloatArray
from counterlight.tools.acquisition.few.order import BLACK, PRIMARIES, Order
from counterlight.tools.acquisition.few.seen import Seen
from counterlight.tools.acquisition.plan import MAD_TO_SIGMA, Noise, Reference

USUAL_ELECTRONS = 1e4  # electrons of the brightest light, assumed until a white picture gives the photon noise
LEVELS = 16  # brightness levels at which noise is measured
BRIGHT = 99.0  # percentile of the floodlight that counts as its brightest light
LEAST_STEP = 1e-5  # share of the brightest light: 16 bits


def reference(order: Order, captures: Sequence[NDArray[np.floating]], saturated: BoolArray) -> Seen:
    """Make the equations of the captures.

    captures : (camera height, camera width, 3) each. Radiance of the first pictures.
    saturated : (camera height, camera width) bool. Pixels saturated in any capture.
    """
    black = np.asarray(captures[BLACK], np.float64)
    above = np.stack([(capture - black).astype(np.float32).reshape(-1, 3) for capture in captures])
    primaries = np.stack([above[number] for number in PRIMARIES], axis=2).astype(np.float64)
    floodlight = primaries.sum(axis=2)
    whites = order.whites(len(captures))
    room = Reference(black, black + floodlight.reshape(black.shape), Noise(np.zeros(3), np.zeros(3)), saturated)
    noise = _by_white(above[whites[0]] - floodlight, floodlight, black) if whites else noise_by_neighbours(room)
    return Seen(order, replace(room, noise=noise), primaries, above)


def noise_by_neighbours(room: Reference) -> Noise:
    """Estimate dark noise from differences of neighbours, an upper bound, and photon noise from usual values."""
    changes = (room.black[:, 1:] - room.black[:, :-1]).reshape(-1, 3) / np.sqrt(2)
    bright = np.percentile(room.light, BRIGHT, axis=0)
    dark = MAD_TO_SIGMA * np.median(np.abs(changes), axis=0)
    return Noise(np.maximum(dark, LEAST_STEP * bright.max()), np.maximum(bright, 0) / USUAL_ELECTRONS)


def _by_white(unadded: FloatArray, floodlight: FloatArray, black: FloatArray) -> Noise:
    """Fit the noise to white minus the sum of red, green and blue.

    unadded : (camera pixels, 3). Combines five captures, with black counted twice.

    Its variance at light L is 8 dark² + 2 gain L. A part proportional to light is no noise: light that does not add up.
    """
    dark, gain = np.zeros(3), np.zeros(3)
    for i in range(3):
        light = np.maximum(floodlight[:, i], 0)
        share = float(np.dot(light, unadded[:, i]) / max(np.dot(light, light), 1e-30))
        order = np.argsort(light)
        parts = np.array_split(order, LEVELS)
        off = unadded[:, i] - share * light
        variance = np.array([(MAD_TO_SIGMA * np.median(np.abs(off[part]))) ** 2 for part in parts])
        design = np.stack([np.full(LEVELS, 8.0), [2 * light[part].mean() for part in parts]], axis=1)
        weights = 1 / np.maximum(variance, 1e-4 * variance.max() + 1e-30)  # a variance's error is proportional to it
        (dark2, gain[i]), _ = nnls(design * weights[:, None], variance * weights)
        dark[i] = np.sqrt(max(dark2, gain[i] * float(black[..., i].mean())))
    least = LEAST_STEP * float(np.percentile(floodlight, BRIGHT))
    return Noise(np.maximum(dark, least), gain)
