"""What a sensor makes of radiance: shot noise, read noise, saturation and code values (EMVA Standard 1288, release 4).

Electrons are Poisson distributed about radiance · exposure · full well, the amplifier adds Gaussian noise, and the
converter rounds to whole codes after the camera's response. T itself is free of noise; this is for pictures of it.
"""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.tools.simulation.devices import Camera, Sensor

SATURATING = 99.9  # percentile of the floodlit room that fills the wells


def capture(radiance: FloatArray, camera: Camera, exposure: float, random: np.random.Generator) -> NDArray[np.uint16]:
    """Code values of a picture, 0 to 2^bits − 1.

    radiance : (rows, columns, 3).  exposure : its inverse is the radiance that saturates a pixel.
    """
    sensor = _sensor(camera)
    expected = np.maximum(radiance, 0) * exposure * sensor.full_well
    electrons = random.poisson(np.minimum(expected, 4 * sensor.full_well)) + random.normal(
        0, sensor.read_noise, np.shape(radiance)
    )
    light = np.clip(electrons / sensor.full_well, 0, 1)
    codes: NDArray[np.uint16] = np.rint(_codes(camera, light) * (2**sensor.bits - 1)).astype(np.uint16)
    return codes


def deviation(camera: Camera, radiance: FloatArray) -> FloatArray:
    """Standard deviation of captured radiance, rounding included, when the brightest pixels just saturate."""
    sensor = _sensor(camera)
    white = float(np.percentile(radiance, SATURATING))
    electrons = np.clip(radiance / white, 0, 1) * sensor.full_well
    rounding = sensor.full_well / (2**sensor.bits - 1) / np.sqrt(12)
    return np.asarray(np.sqrt(electrons + sensor.read_noise**2 + rounding**2) * white / sensor.full_well)


def _codes(camera: Camera, light: FloatArray) -> FloatArray:
    """The response's inverse, light 0..1 to codes 0..1 (rows, columns, 3)."""
    table = camera.response.inverse_table()
    grid = np.linspace(0, 1, len(table))
    return np.stack([np.interp(np.sqrt(light[..., i]), grid, table[:, i]) for i in range(3)], axis=-1)


def _sensor(camera: Camera) -> Sensor:
    if camera.sensor is None:
        raise InputError("the scene's camera has no sensor; add sensor = { bits = 12 } to its [camera]")
    return camera.sensor
