"""Black level: a black projector pixel still emits light, so a share of the floodlight is added to e."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.scene import Scene


def radiance(scene: Scene, composition: FloatArray) -> FloatArray:
    """Returns black_level · T·1, (camera pixels, 3)."""
    return np.asarray(scene.projector.black_level * composition)
