"""A black projector pixel still lets light through: a share of the floodlit room is added to e."""

import numpy as np
from numpy.typing import NDArray

from tools.simulation.scene import Scene


def black_radiance(scene: Scene, composition: NDArray[np.float64]) -> NDArray[np.float64]:
    """(camera pixels, 3): black_level · T·1."""
    return scene.black_level * composition
