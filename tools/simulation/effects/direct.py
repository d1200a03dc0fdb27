"""Direct light: the projector is a pinhole, and one pixel lights each point (thesis eq. 3.2)."""

import numpy as np

from counterlight.tools.simulation.paths import Arrivals, Samples
from counterlight.tools.simulation.projector_side import irradiance
from counterlight.tools.simulation.scene import Scene


def arrivals(scene: Scene, samples: Samples) -> Arrivals:
    """Returns one arrival per sample that lies in the projector picture and faces the projector."""
    x, y, _ = scene.projector.project(samples.point)
    pixel = scene.projector.pixel_at(x, y)
    light = irradiance(scene, samples.point, samples.normal)
    lit = np.flatnonzero((pixel >= 0) & (light > 0))
    origin = np.broadcast_to(scene.projector.position, (lit.size, 3))
    return Arrivals(lit, pixel[lit], light[lit, None], origin, "direct")
