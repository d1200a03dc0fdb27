"""A black projector pixel still lets light through: a share of the floodlit room is added to e."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.scene import Scene


def radiance(scene: Scene, composition: FloatArray) -> FloatArray:
    """(camera pixels, 3): black_level · T·1."""
    return np.asarray(scene.projector.black_level * composition)
