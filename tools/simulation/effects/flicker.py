"""Flicker: a projector's light swings while a camera looks, and the shorter it looks the more it sees (thesis 6.1).

The light is 1 + d cos(2π f t). A picture that is exposed for τ sees 1 + d sinc(f τ) cos(2π f t): nothing of it if τ is
a multiple of 1/f. Nobody keeps the two in step, so each picture has a phase of its own; a sensor that is read row by
row sees bands. T has no flicker; this is for pictures of it.
"""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.devices import Flicker, Sensor
from counterlight.tools.simulation.scene import Scene


def seen(flicker: Flicker, sensor: Sensor, exposure: float) -> float:
    """What is left of the swing in a picture of that exposure, as a share of the light."""
    return float(abs(flicker.depth * np.sinc(flicker.hz * sensor.exposure_s * exposure)))


def deviation(scene: Scene) -> float:
    """Standard deviation of the light in pictures of exposure 1, as a share of it."""
    assert scene.projector.flicker is not None
    return seen(scene.projector.flicker, scene.camera.sensor or Sensor(), 1.0) / float(np.sqrt(2))


def gains(flicker: Flicker, sensor: Sensor, exposure: float, rows: int, random: np.random.Generator) -> FloatArray:
    """The light of each of a picture's rows as a share of the mean, (rows,)."""
    begun = random.random() + flicker.hz * sensor.readout_s * np.arange(rows) / rows
    return np.asarray(1 + seen(flicker, sensor, exposure) * np.cos(2 * np.pi * begun))
