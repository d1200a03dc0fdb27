"""Subsurface scattering: light that enters a translucent surface near a point leaves at the point.

The diffusion profile of Christensen and Burley (2015) fits path-traced infinite slabs that are lit from above. With A
the diffuse albedo, ℓ the mean free path, s = 1.85 − A + 7 |A − 0.8|³ and d = ℓ / s,

    R(r) = A / (8 π d r) · (e^(−r / d) + e^(−r / 3d)),      ∫ R dA = A,

and outgoing radiance is ∫ R(|x − y|) E(y) dA / π. The integral over y is a sum over points around x. Each point has a
radius from the profile's own distribution and an evenly spread angle on the tangent plane at x. The point is then
projected onto the surface along the normal. Points where the surface bends away weigh R(|x − y|) / (R(r) cos). Light
beyond the surface's edge is lost.
"""

from dataclasses import replace

import numpy as np

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.simulation.effects.sequence import even_pairs, tangents
from counterlight.tools.simulation.paths import Samples
from counterlight.tools.simulation.scene import Scene

POINTS = 4  # points per sample and channel
STEEPEST = 0.25  # cosine; steeper points weigh no more than points at this slope
FARTHEST = 1 - 1e-4  # share of the profile that is sampled
CLEARANCE = 1e-3  # metres by which a probe starts higher than the point's distance


def spread(scene: Scene, samples: Samples) -> list[Samples]:
    """Returns the samples; samples on translucent surfaces are spread over their neighbourhood."""
    translucent = np.array([surface.material.translucency is not None for surface in scene.surfaces])
    on = translucent[samples.surface]
    result = [samples.at(~on)]
    for index in np.unique(samples.surface[on]):
        result += _neighbours(scene, samples.at(samples.surface == index), int(index))
    return result


def scale(albedo: FloatArray) -> FloatArray:
    """Returns s of the profile, from the diffuse albedo A in 0..1."""
    return np.asarray(1.85 - albedo + 7 * np.abs(albedo - 0.8) ** 3)


def profile(radius: FloatArray, width: FloatArray) -> FloatArray:
    """Returns R / A per square metre at distance radius > 0 (metres); the width d = ℓ / s is in metres."""
    x = radius / width
    return np.asarray((np.exp(-x) + np.exp(-x / 3)) / (8 * np.pi * width * radius))


def radius_within(share: FloatArray) -> FloatArray:
    """Returns the distance, in units of d, within which the profile has a share (0 ≤ share < 1) of its light.

    1 − share = ¼ e^(−x) + ¾ e^(−x/3) is the cubic y³ + 3 y = 4 (1 − share) in y = e^(−x/3), whose only real root is
    y = 2 sinh(asinh(2 (1 − share)) / 3).
    """
    return np.asarray(-3 * np.log(2 * np.sinh(np.arcsinh(2 * (1 - share)) / 3)))


def _neighbours(scene: Scene, samples: Samples, index: int) -> list[Samples]:
    """Returns POINTS batches of points around the samples of one surface, per channel, or once for equal channels."""
    surface = scene.surfaces[index]
    translucency = surface.material.translucency
    assert translucency is not None
    width = translucency.mean_free_path / scale(surface.material.albedo(samples.u, samples.v))
    alike = bool(np.all(width == width[:, :1]))
    groups = [[0, 1, 2]] if alike else [[0], [1], [2]]
    return [some for group in groups for some in _around(scene, samples, index, width[:, group[0]], group)]


def _around(scene: Scene, samples: Samples, index: int, width: FloatArray, channels: list[int]) -> list[Samples]:
    """Returns points around the samples for some channels; the weights of a sample's points sum to at most 1."""
    carried = np.zeros_like(samples.throughput)
    carried[:, channels] = samples.throughput[:, channels] / POINTS
    found = []
    total = np.zeros(len(width))
    first, second = tangents(samples.normal)
    jitter = even_pairs(len(width))
    for k in range(POINTS):
        share = np.minimum((k + jitter[:, 0]) / POINTS, FARTHEST)
        radius = np.maximum(width * radius_within(share), 1e-9)
        angle = 2 * np.pi * (k / POINTS + jitter[:, 1])
        aside = (radius * np.cos(angle))[:, None] * first + (radius * np.sin(angle))[:, None] * second
        ray, point, weight = _onto_surface(scene, samples, index, aside, radius, width)
        total[ray] += weight / POINTS
        found.append((ray, point, weight))
    excess = np.maximum(total, 1)
    return [replace(point, throughput=carried[ray] * (weight / excess[ray])[:, None]) for ray, point, weight in found]


def _onto_surface(
    scene: Scene, samples: Samples, index: int, aside: FloatArray, radius: FloatArray, width: FloatArray
) -> tuple[IntArray, Samples, FloatArray]:
    """Project points next to the samples onto the surface: indices of the samples, places, and weights.

    A probe starts slightly higher above the tangent plane than the point's distance from the sample. It ends at the
    same depth below the plane.
    """
    height = radius + CLEARANCE
    starts = samples.point + aside + height[:, None] * samples.normal
    met = scene.surfaces[index].shape.meet(starts, -samples.normal)
    near = met.distance <= 2 * height[met.ray]
    ray, normal = met.ray[near], met.normal[near]
    start, down = starts[ray], -samples.normal[ray]
    point = start + met.distance[near, None] * down
    cosine = -np.sum(normal * down, axis=1)
    far = np.maximum(np.linalg.norm(point - samples.point[ray], axis=1), 1e-9)
    weight = profile(far, width[ray]) / profile(radius[ray], width[ray]) / np.maximum(np.abs(cosine), STEEPEST)
    normal = np.where(cosine[:, None] > 0, normal, -normal)
    there = replace(
        samples.at(ray),
        u=met.u[near],
        v=met.v[near],
        facet=met.facet[near],
        point=point,
        normal=normal,
        front=cosine > 0,
        effect="subsurface",
    )
    return ray, there, weight
