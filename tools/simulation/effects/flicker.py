"""Flicker: the projector's light oscillates during an exposure; shorter exposures see more of it (thesis 6.1).

The light is 1 + d cos(2π f t). An exposure of τ sees 1 + d sinc(f τ) cos(2π f t): no flicker if τ is a multiple of 1/f.
Projector and camera are not synchronised, so each picture has its own phase. A sensor that is read row by row sees
bands. T has no flicker; this module serves simulated captures.
"""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.devices import Flicker, Sensor
from counterlight.tools.simulation.scene import Scene


def seen(flicker: Flicker, sensor: Sensor, exposure: float) -> float:
    """Returns the amplitude that an exposure sees, as a share of the light."""
    return float(abs(flicker.depth * np.sinc(flicker.hz * sensor.exposure_s * exposure)))


def deviation(scene: Scene) -> float:
    """Returns the standard deviation of the light in pictures of exposure 1, as a share of the light."""
    assert scene.projector.flicker is not None
    return seen(scene.projector.flicker, scene.camera.sensor or Sensor(), 1.0) / float(np.sqrt(2))


def gains(flicker: Flicker, sensor: Sensor, exposure: float, rows: int, random: np.random.Generator) -> FloatArray:
    """Returns the light of each picture row as a share of the mean, (rows,)."""
    begun = random.random() + flicker.hz * sensor.readout_s * np.arange(rows) / rows
    return np.asarray(1 + seen(flicker, sensor, exposure) * np.cos(2 * np.pi * begun))
