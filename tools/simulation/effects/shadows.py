"""Shadows: light does not arrive if a surface stands between a point and where the light comes from."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.geometry import blocked
from counterlight.tools.simulation.scene import Scene


def shaded(scene: Scene, points: FloatArray, origins: FloatArray) -> NDArray[np.bool_]:
    """Which points (n, 3) get no light from the points (n, 3) of the projector's lens."""
    return blocked(points, origins, scene.surfaces)
