"""Beams: light between neighbouring projector rays, kept together while the rays pass the same faces.

Rays leave the projector through a lattice of points in its picture, finer than its pixels. Each ray is followed from
face to face to where it lands. Four neighbours that passed the same faces in the same way bound a beam. The flux of a
beam is spread over the four-sided patch between the landing points: a widening beam leaves no gaps, and a narrowing
beam becomes bright. Where neighbours separate (at the edge of a glass), each ray deposits its own quarter. Both ways
keep the flux. Beams start at the centre of the projector's lens, so they are sharp even where straight light is not.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.simulation.geometry import Hits, trace
from counterlight.tools.simulation.paths import Batch, Deposits, Rays
from counterlight.tools.simulation.projector_side import pixel_flux
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.simulation.shapes.shape import Shape

if TYPE_CHECKING:
    from counterlight.tools.simulation.effects_on import EffectsOn

CELLS = 2  # lattice cells per axis and projector pixel
MOST_FACES = 10
FAINTEST = 4e-3  # a ray with less than this share of its light is dropped
LEVELS, COARSER = 3, 4  # levels of the map; each level is COARSER times as coarse as the level before
WIDEST_FINE = 3  # patches wider than this many pitches use a coarser level
POINTS_A_PITCH = 1.5
MOST_STEPS = 24  # points along a patch at the coarsest level; a wider patch has points further apart
LONE = 1  # level of rays that belong to no whole beam
BAND_RAYS = 1 << 18  # rays traced at once
Pitches = dict[int, tuple[float, float]]


@dataclass(frozen=True)
class Landed(Batch):
    """Rays that ended on a matt surface.

    tag : number of the ray in the lattice.
    history : number that identifies the faces on the way and what happened at each.
    share : (n, 3). Share of the ray's light that arrived.
    """

    tag: IntArray
    history: IntArray
    share: FloatArray
    surface: IntArray
    u: FloatArray
    v: FloatArray
    facet: IntArray
    front: NDArray[np.bool_]
    point: FloatArray
    normal: FloatArray


@dataclass(frozen=True)
class Lattice:
    """Corners of the lattice cells of some rows of the projector picture; a ray's tag is row · columns + column.

    directions : (rows · columns, 3), unit vectors.
    flux : (cells,), row by row.
    pixel : (cells,). The projector pixel of each cell.
    """

    rows: int
    columns: int
    directions: FloatArray
    flux: FloatArray
    pixel: IntArray

    @property
    def corners(self) -> IntArray:
        """Tags of the corners of each cell, (cells, 4), in order 00, 01, 10, 11."""
        first = (np.arange(self.rows - 1)[:, None] * self.columns + np.arange(self.columns - 1)).ravel()
        return np.stack([first, first + 1, first + self.columns, first + self.columns + 1], axis=1)


@dataclass(frozen=True)
class Beams(Batch):
    """Four-sided beams that land whole on one surface.

    u, v : (n, 4). Places of the corners.
    flux : (n, 3).
    """

    u: FloatArray
    v: FloatArray
    front: NDArray[np.bool_]
    pixel: IntArray
    flux: FloatArray


def deposits(scene: Scene, effects: "EffectsOn", pitches: Pitches) -> Iterator[tuple[int, Deposits]]:
    """Yield projector light that lands on matt surfaces through `forward` of effects, with the level of each batch.

    pitches : for each surface with (u, v), the largest distance in u and in v between points at the finest level. On
        other surfaces every ray is its own deposit. Each level up is COARSER times as coarse.
    """
    height = max(1, BAND_RAYS // (scene.projector.width * CELLS**2))
    for top in range(0, scene.projector.height, height):
        lattice = lattice_of(scene, range(top, min(top + height, scene.projector.height)), effects)
        for landed in follow(scene, lattice, effects):
            index = int(landed.surface[0])
            yield from _bundle(landed, lattice, scene.surfaces[index].shape, pitches.get(index))


def lattice_of(scene: Scene, rows: range, effects: "EffectsOn") -> Lattice:
    """Returns rays through the corners of CELLS × CELLS cells per pixel of some rows."""
    projector = scene.projector
    y = np.linspace(rows.start, rows.stop, len(rows) * CELLS + 1)
    x = np.linspace(0, projector.width, projector.width * CELLS + 1)
    across, down = (part.ravel() for part in np.meshgrid(x, y))
    directions = projector.rays(across, down)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    row, column = np.meshgrid(np.arange(len(rows) * CELLS), np.arange(projector.width * CELLS), indexing="ij")
    pixel = ((rows.start + row // CELLS) * projector.width + column // CELLS).ravel()
    flux = np.full(pixel.size, pixel_flux(scene) / CELLS**2)
    if "vignetting" in effects and projector.vignetting:
        flux *= effects.call("vignetting", "transmission", projector)[pixel]
    return Lattice(y.size, x.size, directions, flux, pixel)


def follow(scene: Scene, lattice: Lattice, effects: "EffectsOn") -> list[Landed]:
    """Returns landed rays, grouped by history and matt surface, without the rays that land there directly."""
    count = len(lattice.directions)
    origins = np.broadcast_to(scene.projector.position, (count, 3))
    rays = Rays(np.arange(count), origins, lattice.directions, np.ones((count, 3)), np.full(count, -1), "direct")
    matt = np.array([surface.matt for surface in scene.surfaces])
    ways = effects.having("forward")
    histories, landed = 1, []
    waiting = [(0, 0, rays)]
    while waiting:
        faces, history, rays = waiting.pop()
        hits = trace(rays.origin, rays.direction, scene.surfaces)
        for index in np.unique(hits.surface[hits.surface >= 0]):
            there = hits.surface == index
            some, met = rays.at(there), hits.at(there)
            if faces and matt[index]:
                landed.append(_landed(some, met, history))
            if faces < MOST_FACES:
                for name in ways:
                    for more in effects.call(name, "forward", scene, some, met, effects):
                        strongest = np.maximum(np.maximum(*more.throughput.T[:2]), more.throughput[:, 2])
                        bright = more.at(strongest > FAINTEST)
                        if bright.pixel.size:
                            waiting.append((faces + 1, histories, bright))
                            histories += 1
    return landed


def _landed(rays: Rays, hits: Hits, history: int) -> Landed:
    places = hits.surface, hits.u, hits.v, hits.facet, hits.front, hits.point, hits.normal
    return Landed(rays.pixel, np.full(rays.pixel.size, history), rays.throughput, *places)


def _bundle(
    landed: Landed, lattice: Lattice, shape: Shape, pitch: tuple[float, float] | None
) -> Iterator[tuple[int, Deposits]]:
    """Yield deposits of rays with one history on one surface: whole beams as patches, broken beams as points."""
    place = np.full(lattice.rows * lattice.columns, -1)
    place[landed.tag] = np.arange(landed.tag.size)
    corner = place[lattice.corners]
    cells = np.flatnonzero((corner >= 0).any(axis=1))
    corner, pixel = corner[cells], lattice.pixel[cells]
    there = corner >= 0
    flux = landed.share[corner] * there[..., None] / 4 * lattice.flux[cells, None, None]
    whole = np.zeros(len(cells), bool)
    if pitch is not None:
        u, v, front = landed.u[corner], landed.v[corner], landed.front[corner]
        # the other cells are cut by a seam
        whole = there.all(axis=1) & (front == front[:, :1]).all(axis=1) & (np.ptp(u, axis=1) < 0.5)
        beams = Beams(u[whole], v[whole], front[whole, 0], pixel[whole], flux[whole].sum(axis=1))
        yield from _patches(shape, int(landed.surface[0]), beams, pitch)
    alone, corners = np.nonzero(there & ~whole[:, None])
    if alone.size:
        some = landed.at(corner[alone, corners])
        places = some.surface, some.u, some.v, some.facet, some.front, some.point, some.normal
        yield LONE, Deposits(pixel[alone], *places, flux[alone, corners], "caustics")


def _patches(shape: Shape, surface: int, beams: Beams, pitch: tuple[float, float]) -> Iterator[tuple[int, Deposits]]:
    """Yield whole beams, each at the level where a few points fill its patch."""
    extent = np.maximum(np.ptp(beams.u, axis=1) / pitch[0], np.ptp(beams.v, axis=1) / pitch[1])
    level = np.searchsorted(WIDEST_FINE * COARSER ** np.arange(LEVELS - 1), extent)
    steps = np.clip(np.ceil(POINTS_A_PITCH * extent / COARSER**level), 1, MOST_STEPS).astype(np.int64)
    for key in np.unique(level * 2 * MOST_STEPS + steps):
        some = beams.at(level * 2 * MOST_STEPS + steps == key)
        yield int(key) // (2 * MOST_STEPS), _patch(shape, surface, some, int(key) % (2 * MOST_STEPS))


def _patch(shape: Shape, surface: int, beams: Beams, steps: int) -> Deposits:
    """Spread steps × steps points over each beam's patch; every point holds an equal part of its flux."""
    blend = _blend(steps)
    copies = len(blend)
    u, v, front = (blend @ beams.u.T).ravel(), (blend @ beams.v.T).ravel(), np.tile(beams.front, copies)
    normal = np.where(front[:, None], 1.0, -1.0) * shape.normals(u, v)
    places = np.full(u.size, surface), u, v, np.full(u.size, -1), front, shape.at(u, v), normal
    return Deposits(np.tile(beams.pixel, copies), *places, np.tile(beams.flux / copies, (copies, 1)), "caustics")


def _blend(count: int) -> FloatArray:
    """Returns the weights (count², 4) of a patch's corners at evenly spread points."""
    offset = (np.arange(count) + 0.5) / count
    s, t = (part.ravel() for part in np.meshgrid(offset, offset))
    return np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], axis=1)
