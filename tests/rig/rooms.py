"""Four rooms: a wall, a corner, a wall behind glass, and two planes, one of them out of focus.

Units are metres, with the camera at the origin looking along z. The projector's raster leaves part of the camera's view
dark, reaches beyond its edge, and partly misses every object.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from tests.rig.footprints import Aperture, Hits, direct_hits, joined
from tests.rig.lattice import SAMPLES, Lattice
from tests.rig.pane import Pane, light_behind
from tests.rig.radiosity import Patches, form_factors
from tests.rig.rays import FloatArray, Pinhole, Rectangle, looking, nearest
from tests.rig.texture import Paint, Painter, lined, painted_grey, painted_red, plaster, sampled, wallpaper

CAMERA, PROJECTOR = (120, 160), (72, 96)
CAMERA_FOCAL, PROJECTOR_FOCAL = 1.374, 1.40  # focal lengths in picture widths, for views of 40° and 39°
PATCH_SAMPLES = 16  # points per side of a patch at which direct light is sampled


@dataclass(frozen=True)
class Surface:
    """A painted rectangle.

    grid : (rows, columns) of its patches; None if it lights no other surface.
    """

    rectangle: Rectangle
    paint: Paint
    grid: tuple[int, int] | None = None


@dataclass(frozen=True)
class Bounces:
    """Light between surfaces.

    hits : direct light on the sub-points of patches.
    gather : (patches, sub-points). Means of the sub-points.
    factors : F.
    paint : (patches, pigments). Means of the paint.
    scatter : (samples, patches). Interpolation of patches at the camera's samples.
    """

    hits: Hits
    gather: sparse.csr_array
    factors: FloatArray
    paint: FloatArray
    scatter: sparse.csr_array


@dataclass(frozen=True, eq=False)
class Room:
    """Geometry of a room: paint and light of every sample of the lattice.

    paint : (samples, pigments), times a pane's transmission; 0 where a ray meets nothing.
    raster : the projector's (height, width).
    """

    name: str
    lattice: Lattice
    raster: tuple[int, int]
    paint: Paint
    hits: Hits
    bounces: Bounces | None = None


def wall(scale: float = 1.0) -> Room:
    """Wallpaper with dark ink, slightly askew."""
    build = _Build("wall", scale, (-0.55, -0.25, 0.1), (0.10, 0.04, 2.2))
    upright = _upright((-1.2, -0.9, 2.12), (0.86, -0.9, 2.28), 1.8)
    return build.room([build.surface(upright, wallpaper, 2.2)])


def corner(scale: float = 1.0) -> Room:
    """A red and a grey wall that meet at 112° and light each other."""
    build = _Build("corner", scale, (-0.35, -0.25, 0.0), (0.05, 0.03, 2.4))
    edge = 0.1, 2.6
    left = _upright((edge[0] - 1.1, -0.85, edge[1] - 0.75), (edge[0], -0.85, edge[1]), 1.7)
    right = _upright((edge[0], -0.85, edge[1]), (edge[0] + 0.95, -0.85, edge[1] - 0.65), 1.7)
    return build.room(
        [
            build.surface(left, painted_red, 2.3, grid=(18, 16)),
            build.surface(right, painted_grey, 2.3, grid=(18, 14)),
        ]
    )


def glass(scale: float = 1.0) -> Room:
    """Plaster behind a bumpy pane that bends the projector's rays and the camera's rays differently."""
    build = _Build("glass", scale, (-0.55, -0.25, 0.1), (0.10, 0.04, 2.3))
    rng = np.random.default_rng(1)
    length, angle = rng.uniform(0.16, 0.35, 6), rng.uniform(0, np.pi, 6)
    number = 2 * np.pi / length
    height = 1.0 / number**2  # bumps of equal curvature, 1/m: each a lens of two metres
    waves = np.stack([height, number * np.cos(angle), number * np.sin(angle), rng.uniform(0, 2 * np.pi, 6)], axis=1)
    pane = Pane(front=1.95, thickness=0.02, index=1.52, waves=waves, coating=0.12)
    behind = Rectangle(np.array([-1.2, -0.9, 2.3]), np.array([2.06, 0, 0]), np.array([0, 1.8, 0]))
    return build.behind(pane, build.surface(behind, plaster, 2.3))


def defocus(scale: float = 1.0) -> Room:
    """A near plane in focus and a far plane out of focus by a disc of two projector pixels' radius."""
    build = _Build("defocus", scale, (0.5, -0.25, 0.0), (0.08, 0.04, 2.2))
    near = _upright((-1.1, -0.9, 2.05), (0.02, -0.9, 2.0), 1.8)
    far = _upright((-0.3, -1.1, 2.6), (1.1, -1.1, 2.65), 2.2)
    focused, blurred = 2.02, 2.63
    pixels = PROJECTOR_FOCAL * PROJECTOR[1]  # the radius counts pixels of the full size at every scale
    aperture = Aperture(2.0 / (pixels * (1 / focused - 1 / blurred)), focused, 13)
    return build.room([build.surface(near, plaster, 2.0), build.surface(far, lined, 2.6)], aperture)


ROOMS: dict[str, Callable[[float], Room]] = {"wall": wall, "corner": corner, "glass": glass, "defocus": defocus}


class _Build:
    """The devices of a room, and the samples of its lattice."""

    def __init__(self, name: str, scale: float, position: Sequence[float], target: Sequence[float]) -> None:
        camera, raster = ((round(h * scale), round(w * scale)) for h, w in (CAMERA, PROJECTOR))
        self.name, self.lattice, self.raster, self._scale = name, Lattice(camera), raster, min(scale, 1.0)
        self.camera = Pinhole(np.zeros(3), np.eye(3), CAMERA_FOCAL * camera[1], camera)
        self.projector = looking(position, target, PROJECTOR_FOCAL * raster[1], raster)
        self._rng = np.random.default_rng([ord(letter) for letter in name])

    def surface(
        self, rectangle: Rectangle, painter: Painter, depth: float, grid: tuple[int, int] | None = None
    ) -> Surface:
        """Returns a surface painted in texels as large as the lattice's samples at that depth.

        grid : patches at full size.
        """
        texel = depth / self.camera.focal / SAMPLES
        rows, columns = (
            max(2, round(float(np.linalg.norm(side)) / texel)) for side in (rectangle.down, rectangle.across)
        )
        cells = None if grid is None else (max(4, round(grid[0] * self._scale)), max(4, round(grid[1] * self._scale)))
        return Surface(rectangle, painter((rows, columns), self._rng), cells)

    def room(self, surfaces: Sequence[Surface], aperture: Aperture | None = None) -> Room:
        """Returns a room of surfaces that the camera sees directly."""
        lens = aperture or Aperture()
        rectangles = [surface.rectangle for surface in surfaces]
        directions = self.camera.directions(*self.lattice.positions())
        met, shares = nearest(rectangles, np.broadcast_to(self.camera.position, directions.shape), directions)
        paint = np.zeros((len(directions), surfaces[0].paint.shape[2]), np.float32)
        hits = []
        for index, surface in enumerate(surfaces):
            mine = np.flatnonzero(met == index)
            paint[mine] = sampled(surface.paint, shares[mine])
            hits.append(self._direct(surface.rectangle, lens, shares[mine], mine, rectangles))
        bounces = self._bounces(surfaces, lens, met, shares)
        return Room(self.name, self.lattice, self.raster, paint, joined(hits), bounces)

    def behind(self, pane: Pane, surface: Surface) -> Room:
        """Returns a room with a surface across z, seen and lit through a pane."""
        rectangle = surface.rectangle
        directions = self.camera.directions(*self.lattice.positions())
        at, leaving, share = pane.through(np.broadcast_to(self.camera.position, directions.shape), directions)
        t, where = rectangle.meet(at, leaving)
        mine = np.flatnonzero(np.isfinite(t))
        paint = np.zeros((len(directions), surface.paint.shape[2]), np.float32)
        paint[mine] = sampled(surface.paint, where[mine]) * share[mine, None]
        points = where[mine] * (np.linalg.norm(rectangle.across), np.linalg.norm(rectangle.down))
        hits = [light_behind(pane, self.projector, rectangle, points, mine, ghost=ghost) for ghost in (False, True)]
        return Room(self.name, self.lattice, self.raster, paint, joined(hits))

    def _direct(
        self,
        rectangle: Rectangle,
        aperture: Aperture,
        shares: FloatArray,
        numbers: np.ndarray,
        rectangles: Sequence[Rectangle],
    ) -> Hits:
        at = rectangle.point(shares)
        normals = np.broadcast_to(rectangle.normal, at.shape)
        others = [other for other in rectangles if other is not rectangle]
        return direct_hits(self.projector, aperture, at, normals, numbers, others)

    def _bounces(
        self, surfaces: Sequence[Surface], aperture: Aperture, met: np.ndarray, shares: FloatArray
    ) -> Bounces | None:
        lighting = [(index, surface) for index, surface in enumerate(surfaces) if surface.grid is not None]
        if not lighting:
            return None
        patches = [Patches(surface.rectangle, surface.grid) for _, surface in lighting if surface.grid]
        hits, paints, scatters, first = [], [], [], 0
        rectangles = [surface.rectangle for surface in surfaces]
        for (index, surface), grid in zip(lighting, patches, strict=True):
            within = grid.points(PATCH_SAMPLES).reshape(-1, 2)
            numbers = first + np.arange(len(within))
            hits.append(self._direct(surface.rectangle, aperture, within, numbers, rectangles))
            paints.append(sampled(surface.paint, within).reshape(grid.count, -1, surface.paint.shape[2]).mean(axis=1))
            mine = np.flatnonzero(met == index)
            place = sparse.coo_array((np.ones(mine.size), (mine, np.arange(mine.size))), shape=(met.size, mine.size))
            scatters.append(sparse.csr_array(place) @ grid.interpolation(shares[mine]))
            first += len(within)
        gather = sparse.kron(
            sparse.eye_array(first // PATCH_SAMPLES**2), np.full((1, PATCH_SAMPLES**2), PATCH_SAMPLES**-2.0)
        )
        scatter = sparse.csr_array(sparse.hstack(scatters), dtype=np.float32)
        return Bounces(
            joined(hits),
            sparse.csr_array(gather),
            form_factors(patches),
            np.concatenate(paints).astype(np.float64),
            scatter,
        )


def _upright(start: Sequence[float], end: Sequence[float], height: float) -> Rectangle:
    """Returns a wall between two upper corners."""
    first = np.asarray(start, np.float64)
    return Rectangle(first, np.asarray(end) - first, np.array([0.0, height, 0.0]))
