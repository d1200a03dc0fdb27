"""Ambient light that is the same from everywhere: radiance ρ E / π at every visible point, without inter-reflection."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.scene import Scene


def radiance(scene: Scene, matt: FloatArray) -> FloatArray:
    """matt : radiance in a pixel per irradiance at the samples, (n, 3). Returns what ambient light adds, (n, 3)."""
    return np.asarray(matt * scene.ambient_irradiance)
