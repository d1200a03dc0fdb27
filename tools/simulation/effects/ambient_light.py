"""Uniform ambient light from all directions: radiance ρ E / π at every visible point, without inter-reflection."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.scene import Scene


def radiance(scene: Scene, matt: FloatArray) -> FloatArray:
    """Returns the radiance that ambient light adds, (n, 3).

    matt : (n, 3). Radiance in a pixel per irradiance at the samples.
    """
    return np.asarray(matt * scene.ambient_irradiance)
