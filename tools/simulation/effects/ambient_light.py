"""Ambient light that is the same from everywhere: radiance ρ E / π at every visible point, without inter-reflection."""

import numpy as np
from numpy.typing import NDArray

from tools.simulation.scene import Scene
from tools.simulation.view import CameraView


def ambient_radiance(scene: Scene, view: CameraView) -> NDArray[np.float64]:
    """(camera pixels, 3) radiance with the projector off."""
    result = np.zeros((scene.camera.width * scene.camera.height, 3))
    for pixels, _, _, albedo in view.patches():
        seen = albedo * scene.ambient_irradiance / np.pi / scene.samples**2
        for i in range(3):
            result[:, i] += np.bincount(pixels, seen[:, i], len(result))
    return result
