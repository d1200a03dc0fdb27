"""Bands of the camera picture that worker processes trace, from camera rows to the matt points that they see."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from uuid import uuid4

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.jobs.workers import Workers
from counterlight.maps.row_map import SparseRows
from counterlight.tools.simulation.effects_on import EffectsOn
from counterlight.tools.simulation.geometry import Hits, trace
from counterlight.tools.simulation.paths import Rays, Samples
from counterlight.tools.simulation.scene import Scene, load_scene


@dataclass(frozen=True)
class SceneSource:
    """The scene file and view that a worker process loads.

    camera, projector : (height, width), or None for the scene's own size.
    run : unique per run, so that a process never reuses what it prepared for an earlier version of the scene.
    """

    path: Path
    camera: tuple[int, int] | None
    projector: tuple[int, int] | None
    view: int
    run: str = field(default_factory=lambda: uuid4().hex)

    def read(self) -> Scene:
        return load_scene(self.path).resized(self.camera, self.projector).views[self.view]


@dataclass(frozen=True)
class Elsewhere:
    """The processes that trace bands, and the scene that they load."""

    workers: Workers
    source: SceneSource


@dataclass(frozen=True)
class Band:
    """Result for some rows of the camera picture.

    near, far, halo : T, U and U' of halo.py; None without far light, or without a halo.
    ambient : e.
    mixing, weight : sums for X, as in crosstalk.of_pixels.
    seen, lit : whether a camera ray met a matt point, and whether projector light reached such a point.
    """

    near: SparseRows
    far: SparseRows | None
    halo: SparseRows | None
    ambient: FloatArray
    mixing: FloatArray
    weight: FloatArray
    seen: bool
    lit: bool


MAX_TURNS = 12  # reflections and refractions of one path
FAINTEST = 1e-4  # a path that carries less of its pixel's radiance ends


def camera_samples(scene: Scene, rows: range, effects: EffectsOn) -> Iterator[Samples]:
    """Yield the matt points that the pixels of some rows see, directly or through effects such as mirrors."""
    waiting = [(0, primary_rays(scene, rows, effects))]
    while waiting:
        turns, rays = waiting.pop()
        hits = trace(rays.origin, rays.direction, scene.surfaces)
        met = hits.surface >= 0
        rays, hits = rays.at(met), hits.at(met)
        if not rays.pixel.size:
            continue
        batches = [_ended(scene, rays, hits)]
        for name in effects.having("spread"):
            batches = [spread for batch in batches for spread in effects.call(name, "spread", scene, batch)]
        yield from (batch for batch in batches if batch.pixel.size)
        if turns < MAX_TURNS:
            for name in effects.having("scatter"):
                going_on = (bright(more) for more in effects.call(name, "scatter", scene, rays, hits, effects))
                waiting += [(turns + 1, more) for more in going_on if more.pixel.size]


def primary_rays(scene: Scene, rows: range, effects: EffectsOn) -> Rays:
    """Returns samples² rays through every pixel of some rows; through the lens' centre if it is in focus."""
    camera = scene.camera
    directions, pixel = camera.pixel_rays(rows, scene.samples)
    origins = np.broadcast_to(camera.position, directions.shape)
    if "camera_defocus" in effects:
        origins, directions = effects.call("camera_defocus", "through_the_lens", scene, directions, pixel)
    throughput = np.full((len(pixel), 3), 1 / scene.samples**2)
    if "vignetting" in effects and camera.vignetting:
        throughput *= effects.call("vignetting", "transmission", camera)[pixel, None]
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return Rays(pixel, origins, directions, throughput, np.full(len(pixel), -1), "direct")


def bright(rays: Rays) -> Rays:
    """Returns the rays that carry enough radiance to be followed."""
    return rays.at(np.maximum(np.maximum(*rays.throughput.T[:2]), rays.throughput[:, 2]) > FAINTEST)


def _ended(scene: Scene, rays: Rays, hits: Hits) -> Samples:
    matt = np.array([surface.matt for surface in scene.surfaces])[hits.surface]
    ends, rays = hits.at(matt), rays.at(matt)
    return Samples(
        rays.pixel,
        ends.surface,
        ends.u,
        ends.v,
        ends.facet,
        ends.point,
        ends.normal,
        ends.front,
        -rays.direction,
        rays.throughput,
        rays.effect,
    )


def paint_of(scene: Scene, samples: Samples) -> FloatArray:
    """The paint's albedo at samples, (n, 3)."""
    result = np.zeros((samples.pixel.size, 3))
    for index, surface in enumerate(scene.surfaces):
        on = samples.surface == index
        if on.any():
            result[on] = surface.material.albedo(samples.u[on], samples.v[on])
    return result


def albedo_of(scene: Scene, samples: Samples, paint: FloatArray, effects: EffectsOn) -> FloatArray:
    """Returns the share (n, 3) of light from all sides that leaves towards the viewer: albedo less the coat's loss."""
    albedo = paint
    for name in effects.having("albedo"):
        albedo = effects.call(name, "albedo", scene, samples, albedo)
    return albedo
