"""Gloss: a clear coat over the paint that reflects like a rough mirror, and reflects other surfaces as well.

The lobe is the microfacet lobe with the GGX distribution (Walter et al. 2007):

    f = F(i·h) D(h) G(i, o) / (4 cos i cos o),      h the half vector,
    D = α² / (π ((α² − 1) cos² h + 1)²),            G = 1 / (1 + Λ(i) + Λ(o)),   Λ(v) = (√(1 + α² tan² v) − 1) / 2,
    F(c) = F₀ + (1 − F₀) (1 − c)⁵                   (Schlick 1994).

The coat transmits light to the paint and back: f = (1 − F(cos i)) (1 − F(cos o)) ρ / π. Both terms are reciprocal, and
together they return at most the light that arrives. Light from one facet that hits another facet is lost. A coat with
roughness below MIRROR is a plain mirror, in which the projector's own lens is not visible.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray
from counterlight.tools.simulation.effects.sequence import even_pairs, tangents
from counterlight.tools.simulation.geometry import Hits
from counterlight.tools.simulation.paths import Rays, Samples
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.simulation.surfaces import Surface

if TYPE_CHECKING:
    from counterlight.tools.simulation.effects_on import EffectsOn

MIRROR = 0.01  # roughness below which a coat is a plain mirror
FACETS = 16  # directions per projector ray that a rough coat reflects
EVEN = 1 / 21  # mean of (1 − c)⁵ over uniform light from all sides


def scatter(scene: Scene, rays: Rays, hits: Hits, effects: "EffectsOn") -> list[Rays]:
    """Returns one reflected ray for each ray that meets a coat, drawn from the lobe, on the camera's side."""
    result = []
    for surface, met in _coated(scene, hits.surface):
        there, place = rays.at(met), hits.at(met)
        result.append(_reflected(surface, there, place, even_pairs(len(place.surface))))
    return result


def forward(scene: Scene, rays: Rays, hits: Hits, effects: "EffectsOn") -> list[Rays]:
    """Returns what coats reflect of the projector's light: FACETS batches, each with the same draw for all rays."""
    result = []
    for surface, met in _coated(scene, hits.surface):
        there, place = rays.at(met), hits.at(met)
        coat = surface.material.gloss
        count = 1 if coat is None or coat.roughness < MIRROR else FACETS
        for pair in even_pairs(count):
            drawn = _reflected(surface, there, place, np.broadcast_to(pair, (len(place.surface), 2)))
            result.append(replace(drawn, throughput=drawn.throughput / count))
    return result


def reflectance(scene: Scene, samples: Samples, to_light: FloatArray, paint: FloatArray) -> FloatArray:
    """Returns f (n, 3), 1/sr, of coated samples for light from unit directions.

    A NaN direction means light from all sides; f is then the paint's f alone.
    """
    result = paint.copy()
    for surface, on in _coated(scene, samples.surface):
        coat = surface.material.gloss
        assert coat is not None
        there, source = samples.at(on), to_light[on]
        cos_in = np.sum(source * there.normal, axis=1)
        gets = np.where(np.isnan(cos_in), 1 - mean_fresnel(coat.reflectance), 1 - fresnel(cos_in, coat.reflectance))
        gives = 1 - fresnel(np.sum(there.towards * there.normal, axis=1), coat.reflectance)
        result[on] = paint[on] * (gets * gives)[:, None]
        if coat.roughness >= MIRROR:
            shine = lobe_between(source, there.towards, there.normal, coat.roughness, coat.reflectance)
            result[on] += np.nan_to_num(shine)[:, None]
    return result


def albedo(scene: Scene, samples: Samples, paint: FloatArray) -> FloatArray:
    """Returns the share (n, 3) of uniform light that leaves the paint through the coat towards the viewer."""
    result = paint.copy()
    for surface, on in _coated(scene, samples.surface):
        coat = surface.material.gloss
        assert coat is not None
        there = samples.at(on)
        gives = 1 - fresnel(np.sum(there.towards * there.normal, axis=1), coat.reflectance)
        result[on] *= (gives * (1 - mean_fresnel(coat.reflectance)))[:, None]
    return result


def fresnel(cosine: FloatArray, head_on: float) -> FloatArray:
    """Returns the share that a facet reflects (Schlick), from F₀."""
    return np.asarray(head_on + (1 - head_on) * (1 - np.clip(cosine, 0, 1)) ** 5)


def mean_fresnel(head_on: float) -> float:
    """Returns the share that a facet reflects of uniform light: ∫ F cos dω / π."""
    return head_on + (1 - head_on) * EVEN


def lobe_between(
    towards: FloatArray, leaving: FloatArray, normals: FloatArray, roughness: float, head_on: float
) -> FloatArray:
    """Returns f (n,), 1/sr; 0 below the surface.

    towards, leaving : (n, 3), unit vectors to the source of the light and to its destination.
    """
    half = towards + leaving
    half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-30)
    cos_in, cos_out, cos_half = (np.sum(vectors * normals, axis=1) for vectors in (towards, leaving, half))
    above = (cos_in > 0) & (cos_out > 0)
    i, o = np.where(above, cos_in, 1.0), np.where(above, cos_out, 1.0)
    facets = _distribution(cos_half, roughness) / (1 + _shade(i, roughness) + _shade(o, roughness))
    return np.where(above, facets * fresnel(np.sum(towards * half, axis=1), head_on) / (4 * i * o), 0.0)


def sampled(
    leaving: FloatArray, normals: FloatArray, roughness: float, head_on: float, random: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Draw directions (n, 3) of incoming light for light that leaves towards `leaving`, with weights (n,) f cos i / p.

    Facets are drawn in proportion to their visible area from `leaving` (Heitz 2018), so the weight F G / G₁ is at most
    1. Directions below the surface have weight 0.

    random : (n, 2) in 0..1.
    """
    first, second = tangents(normals)
    axes = np.stack([first, second, normals], axis=1)
    seen = np.einsum("nij,nj->ni", axes, leaving)
    facet = _visible_facet(seen, roughness, random)
    along = np.sum(seen * facet, axis=1)
    local = 2 * along[:, None] * facet - seen
    cos_in, cos_out = local[:, 2], np.maximum(seen[:, 2], 1e-9)
    shade_in, shade_out = _shade(np.maximum(cos_in, 1e-9), roughness), _shade(cos_out, roughness)
    weight = fresnel(along, head_on) * (1 + shade_out) / (1 + shade_out + shade_in)
    return np.einsum("nij,ni->nj", axes, local), np.where(cos_in > 0, weight, 0.0)


def _coated(scene: Scene, index: NDArray[np.int64]) -> list[tuple[Surface, BoolArray]]:
    """Returns the coated surfaces, each with the mask of the places on it."""
    coated = [(surface, index == k) for k, surface in enumerate(scene.surfaces) if surface.material.gloss is not None]
    return [(surface, on) for surface, on in coated if on.any()]


def _reflected(surface: Surface, rays: Rays, hits: Hits, random: FloatArray) -> Rays:
    coat = surface.material.gloss
    assert coat is not None
    if coat.roughness < MIRROR:
        cosine = -np.sum(rays.direction * hits.normal, axis=1)
        onward, weight = rays.direction + 2 * cosine[:, None] * hits.normal, fresnel(cosine, coat.reflectance)
    else:
        onward, weight = sampled(-rays.direction, hits.normal, coat.roughness, coat.reflectance, random)
    throughput = rays.throughput * weight[:, None]
    return replace(rays, origin=hits.point, direction=onward, throughput=throughput, effect="gloss")


def _distribution(cos_half: FloatArray, roughness: float) -> FloatArray:
    square = roughness**2
    return np.asarray(square / (np.pi * ((square - 1) * cos_half**2 + 1) ** 2))


def _shade(cosine: FloatArray, roughness: float) -> FloatArray:
    """Returns Λ of Smith's shadowing."""
    return np.asarray((np.sqrt(1 + roughness**2 * (1 / cosine**2 - 1)) - 1) / 2)


def _visible_facet(seen: FloatArray, roughness: float, random: FloatArray) -> FloatArray:
    """Returns facet normals (n, 3), z up, drawn by their area as seen from unit vectors `seen` (Heitz 2018)."""
    squeeze = np.array([roughness, roughness, 1.0])
    stretched = seen * squeeze
    stretched /= np.linalg.norm(stretched, axis=1, keepdims=True)
    across = np.stack([-stretched[:, 1], stretched[:, 0], np.zeros(len(seen))], axis=1)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = np.where(length > 1e-9, across / np.maximum(length, 1e-9), [1.0, 0.0, 0.0])
    radius, angle = np.sqrt(random[:, 0]), 2 * np.pi * random[:, 1]
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    share = (1 + stretched[:, 2]) / 2
    y = (1 - share) * np.sqrt(np.maximum(1 - x**2, 0)) + share * y
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    facet = x[:, None] * across + y[:, None] * np.cross(stretched, across) + z[:, None] * stretched
    facet *= squeeze
    facet[:, 2] = np.maximum(facet[:, 2], 1e-9)
    return np.asarray(facet / np.linalg.norm(facet, axis=1, keepdims=True))
