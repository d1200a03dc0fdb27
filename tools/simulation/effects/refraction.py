"""Refraction: light through clear solids, by Snell's and Fresnel's laws (Born and Wolf, Principles of Optics, 1.5).

With i and t the cosines on the incoming and the outgoing side and η = n_from / n_to,

    t² = 1 − η² (1 − i²)                                   (Snell; negative: total internal reflection)
    R = ½ [((η i − t) / (η i + t))² + ((i − η t) / (i + η t))²]   (Fresnel, unpolarised)

At every face light continues both ways. Inside, it fades as e^(−a · distance) (Beer-Lambert). Solids stand in air and
do not touch. `scatter` serves the camera side and carries radiance, which is n² times as dense inside. `forward` serves
the projector side and carries flux.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.geometry import Hits
from counterlight.tools.simulation.paths import Rays, joined
from counterlight.tools.simulation.scene import Scene

if TYPE_CHECKING:
    from counterlight.tools.simulation.effects_on import EffectsOn


def scatter(scene: Scene, rays: Rays, hits: Hits, effects: "EffectsOn") -> list[Rays]:
    """Returns the rays that continue from clear faces, backwards from the camera."""
    ways = _split(scene, rays, hits, effects, radiance=True)
    return [joined(ways)] if ways else []


def forward(scene: Scene, rays: Rays, hits: Hits, effects: "EffectsOn") -> list[Rays]:
    """Returns the projector rays that continue from clear faces; one batch per way that light can take."""
    return _split(scene, rays, hits, effects, radiance=False)


def reflected(directions: FloatArray, normals: FloatArray) -> FloatArray:
    """Returns mirrored unit directions (n, 3); the sign of the normals does not matter."""
    return np.asarray(directions - 2 * np.sum(directions * normals, axis=1)[:, None] * normals)


def refracted(directions: FloatArray, normals: FloatArray, ratio: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns unit directions (n, 3) beyond a face, and the share R (n,) that the face reflects.

    Under total reflection R is 1 and the direction is tangential.

    directions : (n, 3), unit.
    normals : (n, 3), unit, on the side of the incoming light.
    ratio : (n,) η = n_from / n_to.
    """
    cos_in = -np.sum(directions * normals, axis=1)
    cos_out = np.sqrt(np.maximum(1 - ratio**2 * (1 - cos_in**2), 0))
    bent = ratio[:, None] * directions + (ratio * cos_in - cos_out)[:, None] * normals
    return bent / np.linalg.norm(bent, axis=1, keepdims=True), reflectance_of(cos_in, cos_out, ratio)


def reflectance_of(cos_in: FloatArray, cos_out: FloatArray, ratio: FloatArray) -> FloatArray:
    """Returns Fresnel's R of unpolarised light, 0..1; 1 where cos_out is 0."""
    across = (ratio * cos_in - cos_out) / np.maximum(ratio * cos_in + cos_out, 1e-30)
    along = (cos_in - ratio * cos_out) / np.maximum(cos_in + ratio * cos_out, 1e-30)
    return np.asarray((across**2 + along**2) / 2)


def _split(scene: Scene, rays: Rays, hits: Hits, effects: "EffectsOn", *, radiance: bool) -> list[Rays]:
    result = []
    for index, surface in enumerate(scene.surfaces):
        solid = surface.material.dielectric
        met = hits.surface == index
        if solid is None or not met.any():
            continue
        there, place = rays.at(met), hits.at(met)
        inside = (~place.front * place.distance)[:, None]
        throughput = there.throughput * np.exp(-solid.absorption * inside)
        if "dispersion" in effects and np.isfinite(solid.abbe):
            indices = effects.call("dispersion", "channel_indices", solid.index, solid.abbe)
            for channel, n in enumerate(indices):
                own = throughput * (np.arange(3) == channel)
                result += _both_ways(replace(there, throughput=own), place, index, float(n), radiance)
        else:
            result += _both_ways(replace(there, throughput=throughput), place, index, solid.index, radiance)
    return result


def _both_ways(rays: Rays, hits: Hits, surface: int, index: float, radiance: bool) -> list[Rays]:
    """Returns the refracted and the reflected rays."""
    ratio = np.where(hits.front, 1 / index, index)
    bent, share = refracted(rays.direction, hits.normal, ratio)
    density = ratio**2 if radiance else np.ones_like(ratio)
    through = replace(
        rays,
        origin=hits.point,
        direction=bent,
        throughput=rays.throughput * (density * (1 - share))[:, None],
        inside=np.where(hits.front, surface, -1),
        effect="refraction",
    )
    back = replace(
        rays,
        origin=hits.point,
        direction=reflected(rays.direction, hits.normal),
        throughput=rays.throughput * share[:, None],
        effect="refraction",
    )
    return [through, back]
