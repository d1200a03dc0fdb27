"""Direct light: the projector as a pinhole, each point lit by the one pixel that it projects to (thesis eq. 3.2)."""

import numpy as np

from counterlight.tools.simulation.paths import Arrivals, Samples
from counterlight.tools.simulation.projector_side import irradiance
from counterlight.tools.simulation.scene import Scene


def arrivals(scene: Scene, samples: Samples) -> Arrivals:
    """One arrival for each sample inside the projector's picture that faces it."""
    x, y, _ = scene.projector.project(samples.point)
    pixel = scene.projector.pixel_at(x, y)
    light = irradiance(scene, samples.point, samples.normal)
    lit = np.flatnonzero((pixel >= 0) & (light > 0))
    origin = np.broadcast_to(scene.projector.position, (lit.size, 3))
    return Arrivals(lit, pixel[lit], light[lit, None], origin, "direct")
