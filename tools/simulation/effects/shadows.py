"""Shadows: light does not arrive if a surface stands between a point and the light's origin."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.geometry import blocked
from counterlight.tools.simulation.scene import Scene


def shaded(scene: Scene, points: FloatArray, origins: FloatArray) -> NDArray[np.bool_]:
    """Returns the mask of points (n, 3) that get no light from `origins` (n, 3), points of the projector's lens."""
    return blocked(points, origins, scene.surfaces)
