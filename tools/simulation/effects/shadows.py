"""Shadows: a point is dark if a surface stands between it and the projector."""

import numpy as np
from numpy.typing import NDArray

from tools.simulation.geometry import blocked
from tools.simulation.scene import Scene


def shaded(scene: Scene, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points (n, 3) on surfaces the projector does not see."""
    return blocked(points, scene.projector.position, scene.surfaces)
