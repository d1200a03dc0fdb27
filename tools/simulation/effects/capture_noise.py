"""What a sensor makes of radiance: shot noise, read noise, saturation and code values (EMVA Standard 1288, release 4).

Electrons are Poisson distributed about light · full well, the amplifier adds Gaussian noise, and the converter rounds
to whole codes after the camera's response. T itself is free of noise; this is for pictures of it.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.simulation.devices import Camera, Sensor

SATURATING = 99.9  # percentile of the floodlit room that fills the wells
OVERFLOW = 2.0  # light above that is as bright as that
ENCODING_STEPS = 1 << 16


def capture(
    light: FloatArray,
    sensor: Sensor,
    response: Response,
    random: np.random.Generator,
    developed: Callable[[FloatArray], FloatArray] | None = None,
) -> NDArray[np.uint16]:
    """Code values of a picture, 0 to 2^bits − 1.

    light : (rows, columns, 3), radiance times exposure; 1 fills the wells.
    developed : what the camera makes of the sensor's picture before its response; None: nothing.
    """
    if sensor.full_well:
        electrons = random.poisson(np.clip(light, 0, OVERFLOW) * sensor.full_well)
        light = (electrons + random.normal(0, sensor.read_noise, np.shape(light))) / sensor.full_well
    light = np.clip(light, 0, 1)
    light = light if developed is None else developed(light)
    codes: NDArray[np.uint16] = np.rint(_codes(light, response) * (2**sensor.bits - 1)).astype(np.uint16)
    return codes


def deviation(camera: Camera, radiance: FloatArray) -> FloatArray:
    """Standard deviation of captured radiance, rounding included, when the brightest pixels just saturate."""
    sensor = camera.sensor
    if sensor is None:
        raise InputError("the scene's camera has no sensor; add sensor = { bits = 12 } to its [camera]")
    white = float(np.percentile(radiance, SATURATING))
    electrons = np.clip(radiance / white, 0, 1) * sensor.full_well
    rounding = sensor.full_well / (2**sensor.bits - 1) / np.sqrt(12)
    return np.asarray(np.sqrt(electrons + sensor.read_noise**2 + rounding**2) * white / sensor.full_well)


def _codes(light: FloatArray, response: Response) -> FloatArray:
    """The response's inverse, light 0..1 to codes 0..1 (rows, columns, 3)."""
    if response.kind == "linear":
        return light
    codes, curve = _curve(response)
    return np.stack([np.interp(light[..., i], curve[:, i], codes) for i in range(3)], axis=-1)


@lru_cache(maxsize=2)
def _curve(response: Response) -> tuple[FloatArray, FloatArray]:
    """Equally spaced code values, (steps,), and their light, (steps, 3)."""
    codes = np.linspace(0, 1, ENCODING_STEPS)
    return codes, response.to_linear(np.repeat(codes[:, None], 3, axis=1))
