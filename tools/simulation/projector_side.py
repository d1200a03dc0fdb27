"""The projector side of every light path: the projector pixels that light a point, and where their light lands.

The projector lights a plane across its axis evenly, as real projectors are built to do. At depth z along the axis the
irradiance on such a plane is E⊥ = π · brightness · (z₀ / z)², with z₀ the distance of look_at. A white card at z₀
then has radiance `brightness`. On a surface turned by θ towards a beam at α from the axis, E = E⊥ cos θ / cos α. Every
projector pixel then carries the same flux, π · brightness · z₀² times its area on the plane at depth 1. Irradiance
grows in proportion to the pixel density of the lens.
"""

from collections.abc import Iterator

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.effects_on import EffectsOn
from counterlight.tools.simulation.geometry import trace
from counterlight.tools.simulation.paths import Arrivals, Deposits, Samples
from counterlight.tools.simulation.scene import Scene

BAND_BEAMS = 1 << 18  # beams traced at once
BEAMS = 2  # beams per axis and projector pixel, for the light on cells


def irradiance(scene: Scene, points: FloatArray, normals: FloatArray) -> FloatArray:
    """Returns the irradiance of a white picture without shadows, (n,); 0 on the far side.

    points, normals : (n, 3). Normals have length 1.
    """
    projector = scene.projector
    towards = points - projector.position
    depth = towards @ projector.forward
    distance = np.linalg.norm(towards, axis=1)
    cos_surface = np.maximum(-np.sum(towards * normals, axis=1) / distance, 0)
    lit = depth > 0
    safe = np.where(lit, depth, 1.0)
    across = np.pi * projector.brightness * (projector.target_distance / safe) ** 2
    crowded = projector.crowding(towards @ projector.right / safe, towards @ projector.up / safe)
    return np.where(lit, across * cos_surface * distance / safe * crowded, 0.0)


def pixel_flux(scene: Scene) -> float:
    """Returns the power that leaves one projector pixel per unit drive."""
    projector = scene.projector
    return float(np.pi * projector.brightness * projector.target_distance**2 * projector.pixel_area)


def arrivals(scene: Scene, samples: Samples, effects: EffectsOn) -> Iterator[Arrivals]:
    """Yield direct projector light that reaches samples, before shadows are removed."""
    if "direct" in effects:
        if "projector_defocus" in effects:
            yield from effects.call("projector_defocus", "arrivals", scene, samples)
        else:
            yield effects.call("direct", "arrivals", scene, samples)


def deposits(scene: Scene, effects: EffectsOn, beams: int = BEAMS) -> Iterator[Deposits]:
    """Yield the matt points where beams² beams per projector pixel land directly, in bands of projector rows."""
    projector = scene.projector
    flux = pixel_flux(scene) / beams**2
    share = np.ones(projector.pixels)
    if "vignetting" in effects and projector.vignetting:
        share = effects.call("vignetting", "transmission", projector)
    matt = np.array([surface.matt for surface in scene.surfaces])
    height = max(1, BAND_BEAMS // (projector.width * beams**2))
    for top in range(0, projector.height, height):
        rows = range(top, min(top + height, projector.height))
        directions, pixel = projector.pixel_rays(rows, beams)
        hits = trace(projector.position, directions, scene.surfaces)
        lands = (hits.surface >= 0) & matt[hits.surface]
        hits, pixel = hits.at(lands), pixel[lands]
        power = flux * share[pixel, None]
        yield Deposits(
            pixel, hits.surface, hits.u, hits.v, hits.facet, hits.front, hits.point, hits.normal, power, "direct"
        )
