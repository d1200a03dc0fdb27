"""Sensor noise: shot noise, read noise, saturation and code values (EMVA Standard 1288, release 4).

Electrons are Poisson distributed about light · full well. The amplifier adds Gaussian noise. The converter rounds to
whole codes after the camera's response. T itself has no noise; this module serves simulated captures.

Poisson numbers of a mean μ ≥ FEW are made from normal numbers z, three times as fast as by rejection. They are the
integers nearest to the quantiles from cumulants (Cornish and Fisher 1938),

    μ + √(μ − 1/12) z + (z² − 1) / 6 + (z − z³) / (72 √μ).
"""

import math
from collections.abc import Callable

import numba
import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.maps.products import compiled
from counterlight.response import Response
from counterlight.tools.simulation.devices import Camera, Sensor

SATURATING = 99.9  # percentile of the floodlit room's light that fills the wells
OVERFLOW = 2.0  # brighter light is clipped to this level
FEW = 16.0  # electrons; with a larger mean, no probability is wrong by more than 5e-4 of the largest
MANY = 1 << 16  # number of values from which all cores are used


def capture(
    light: FloatArray,
    sensor: Sensor,
    response: Response,
    random: np.random.Generator,
    developed: Callable[[FloatArray], FloatArray] | None = None,
) -> NDArray[np.uint16]:
    """Returns the code values of a picture, 0 to 2^bits − 1.

    light : (rows, columns, 3). Radiance times exposure; 1 fills the wells.
    developed : conversion of the sensor's picture before the response; None for no conversion.
    """
    if sensor.full_well:
        light = _noisy(light, sensor, random)
    light = np.clip(light, 0, 1)
    light = light if developed is None else developed(light)
    if response.kind != "linear":
        from counterlight.tools.simulation.effects.camera_curve import encoded  # imported only for a curve

        light = encoded(light, response)
    codes: NDArray[np.uint16] = np.rint(light * (2**sensor.bits - 1)).astype(np.uint16)
    return codes


def _noisy(light: FloatArray, sensor: Sensor, random: np.random.Generator) -> FloatArray:
    """Returns noisy electrons, read noise included, as a share of the full well."""
    electrons = np.ascontiguousarray(np.clip(light, 0, OVERFLOW) * sensor.full_well)
    few = electrons < FEW
    counted = random.poisson(electrons[few])
    photons, amplifier = (random.standard_normal(electrons.shape, np.float32) for _ in range(2))
    _MANY_ELECTRONS[electrons.size >= MANY](electrons.ravel(), photons.ravel())
    electrons[few] = counted
    noisy: FloatArray = (electrons + sensor.read_noise * amplifier) / sensor.full_well
    return noisy


def _many_electrons(electrons: FloatArray, normal: NDArray[np.float32]) -> None:
    """Replace means by Poisson numbers, in place, made from normal numbers."""
    for i in numba.prange(electrons.size):
        mean, z = electrons[i], np.float64(normal[i])
        if mean >= FEW:
            spread = math.sqrt(mean - 1 / 12) * z + (z * z - 1) / 6 + (z - z**3) / (72 * math.sqrt(mean))
            electrons[i] = np.rint(mean + spread)


_MANY_ELECTRONS = compiled(_many_electrons)


def deviation(camera: Camera, radiance: FloatArray) -> FloatArray:
    """Returns the standard deviation of captured radiance, with rounding, when the brightest pixels just saturate."""
    sensor = camera.sensor
    if sensor is None:
        raise InputError("the scene's camera has no sensor; add sensor = { bits = 12 } to its [camera]")
    white = float(np.percentile(radiance, SATURATING))
    electrons = np.clip(radiance / white, 0, 1) * sensor.full_well
    rounding = sensor.full_well / (2**sensor.bits - 1) / np.sqrt(12)
    return np.asarray(np.sqrt(electrons + sensor.read_noise**2 + rounding**2) * white / sensor.full_well)
