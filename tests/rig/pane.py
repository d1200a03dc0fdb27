"""A pane of glass, bumpy in front and flat behind: its effect on rays, and the projector's light behind it.

Rays through the raster are followed to the wall as the corners of a fine mesh. A triangle of the mesh carries its flux
to where it lands, so that folds double a footprint, and spread light is dimmer. A second mesh is the light that the
pane's two faces reflect once inside (a ghost).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.rig.footprints import Hits, flux
from tests.rig.rays import FloatArray, Pinhole, Rectangle

MESH = 4  # corners per side of a projector pixel
MARGIN = 6  # margin of projector pixels beyond the raster
NEWTON = 4


@dataclass(frozen=True)
class Pane:
    """Glass between two faces across z: in front z = front + bumps(x, y), behind z = front + thickness.

    waves : (n, 4). Height in metres, wave numbers along x and y in 1/m, phase.
    coating : reflectance of either face at any angle; None: bare glass, by Fresnel.
    """

    front: float
    thickness: float
    index: float
    waves: FloatArray
    coating: float | None = None

    def bumps(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns the height and its derivatives along x and y."""
        height, along_x, along_y, phase = (column[:, None] for column in self.waves.T)
        at = along_x * x + along_y * y + phase
        slope = height * np.cos(at)
        return (height * np.sin(at)).sum(axis=0), (slope * along_x).sum(axis=0), (slope * along_y).sum(axis=0)

    def through(
        self, origins: FloatArray, directions: FloatArray, *, ghost: bool = False
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns where rays leave the back, their direction, and the share of their light: (n, 3), (n, 3), (n,).

        ghost : whether the path has one reflection at the back and one at the front.
        """
        at, normal = self._front(origins, directions)
        inner, share = self._enter(directions, normal)
        at = self._to_back(at, inner)
        flat = np.broadcast_to([0.0, 0.0, 1.0], at.shape)
        if ghost:
            share = share * self._reflectance(np.abs(inner[:, 2]), self.index)
            at, normal = self._front(at, inner * (1, 1, -1))
            inner = inner * (1, 1, -1)
            share = share * self._reflectance(np.abs(np.sum(inner * normal, axis=1)), self.index)
            inner = inner - 2 * np.sum(inner * normal, axis=1, keepdims=True) * normal
            at = self._to_back(at, inner)
        share = share * (1 - self._reflectance(np.abs(inner[:, 2]), self.index))
        return at, refracted(inner, flat, self.index), share

    def _front(self, origins: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns where rays meet the bumpy face, and its normal away from the camera, by Newton's method."""
        t = (self.front - origins[:, 2]) / directions[:, 2]
        for _ in range(NEWTON):
            at = origins + t[:, None] * directions
            height, slope_x, slope_y = self.bumps(at[:, 0], at[:, 1])
            error = at[:, 2] - self.front - height
            t = t - error / (directions[:, 2] - slope_x * directions[:, 0] - slope_y * directions[:, 1])
        at = origins + t[:, None] * directions
        _, slope_x, slope_y = self.bumps(at[:, 0], at[:, 1])
        normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=1)
        return at, normal / np.linalg.norm(normal, axis=1, keepdims=True)

    def _enter(self, directions: FloatArray, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
        cosine = np.abs(np.sum(directions * normal, axis=1))
        return refracted(directions, normal, 1 / self.index), 1 - self._reflectance(cosine, 1 / self.index)

    def _to_back(self, at: FloatArray, directions: FloatArray) -> FloatArray:
        t = (self.front + self.thickness - at[:, 2]) / directions[:, 2]
        return at + t[:, None] * directions

    def _reflectance(self, cosine: FloatArray, ratio: float) -> FloatArray:
        return fresnel(cosine, ratio) if self.coating is None else np.full_like(cosine, self.coating)


def refracted(directions: FloatArray, normal: FloatArray, ratio: float) -> FloatArray:
    """Apply Snell's law to unit vectors; total reflection gives a direction along the face.

    ratio : index before the face over the index behind it.
    """
    cosine = np.sum(directions * normal, axis=1, keepdims=True)
    normal = np.where(cosine < 0, -normal, normal)
    cosine = np.abs(cosine)
    behind = np.sqrt(np.maximum(1 - ratio**2 * (1 - cosine**2), 0))
    return np.asarray(ratio * directions + (behind - ratio * cosine) * normal)


def fresnel(cosine: FloatArray, ratio: float) -> FloatArray:
    """Returns a face's reflectance for unpolarised light.

    ratio : index before the face over the index behind it.
    """
    behind = np.sqrt(np.maximum(1 - ratio**2 * (1 - cosine**2), 0))
    across = (ratio * cosine - behind) / (ratio * cosine + behind)
    along = (cosine * 1 - ratio * behind) / (cosine + ratio * behind)
    return np.asarray((across**2 + along**2) / 2)


def light_behind(
    pane: Pane, projector: Pinhole, wall: Rectangle, points: FloatArray, numbers: NDArray[np.int64], *, ghost: bool
) -> Hits:
    """Returns the light through the pane on points (n, 2) of the wall's plane, in metres along its sides."""
    uv, landed, share = _mesh(pane, projector, wall, ghost=ghost)
    triangles = _triangles(uv.shape[:2])
    triangles = triangles[np.isfinite(landed.reshape(-1, 2)).all(axis=1)[triangles].all(axis=1)]
    corners, landed = uv.reshape(-1, 2)[triangles], landed.reshape(-1, 2)[triangles]
    pairs, inside = located(points, landed)
    triangle, point = pairs
    position = np.einsum("nc,nci->ni", inside, corners[triangle])
    transmitted = np.einsum("nc,nc->n", inside, share.ravel()[triangles[triangle]])
    area = np.abs(_twice_area(landed))[triangle]
    irradiance = flux(projector, position) * transmitted * np.abs(_twice_area(corners))[triangle] / area
    return Hits(numbers[point], position, irradiance)


def _mesh(pane: Pane, projector: Pinhole, wall: Rectangle, *, ghost: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns raster positions, where their rays land (metres along the wall's sides), and the share that arrives."""
    height, width = projector.size
    v, u = np.meshgrid(
        *(np.arange(-MARGIN * MESH, (n + MARGIN) * MESH + 1) / MESH for n in (height, width)), indexing="ij"
    )
    directions = projector.directions(u.ravel(), v.ravel())
    at, leaving, share = pane.through(np.broadcast_to(projector.position, directions.shape), directions, ghost=ghost)
    t = wall.distance(at, leaving)
    sides = np.array([np.linalg.norm(wall.across), np.linalg.norm(wall.down)])
    reached = np.where(np.isfinite(t), t, np.nan)  # rays under total reflection land nowhere
    landed = wall.shares(at + reached[:, None] * leaving) * sides
    return np.stack([u, v], axis=-1), landed.reshape(*u.shape, 2), share.reshape(u.shape)


def _triangles(shape: tuple[int, int]) -> NDArray[np.int64]:
    """Returns (triangles, 3), corners of a mesh of squares, each cut in two."""
    number = np.arange(shape[0] * shape[1]).reshape(shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    return np.concatenate([np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([b, d, c], axis=-1).reshape(-1, 3)])


def _twice_area(corners: FloatArray) -> FloatArray:
    """Returns the signed double area of triangles (n, 3, 2)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def located(
    points: FloatArray, triangles: FloatArray
) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], FloatArray]:
    """Returns every pair of a triangle and a point inside it, with barycentric coordinates: ((n,), (n,)), (n, 3).

    Both are sorted into square cells as large as a typical triangle. A point exactly on an edge is in neither triangle.

    points : (m, 2).
    triangles : (k, 3, 2).
    """
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    cell = float(np.median(high - low)) * 1.5
    origin = points.min(axis=0)
    grid = np.floor((points.max(axis=0) - origin) / cell).astype(np.int64) + 1
    least = np.clip(np.floor((low - origin) / cell), 0, grid).astype(np.int64)
    most = np.clip(np.floor((high - origin) / cell), -1, grid - 1).astype(np.int64)
    spans = np.maximum(most - least + 1, 0)
    triangle, within = _expanded(spans[:, 0] * spans[:, 1])
    column = least[triangle, 0] + within % np.maximum(spans[triangle, 0], 1)
    row = least[triangle, 1] + within // np.maximum(spans[triangle, 0], 1)
    of_point = np.floor((points - origin) / cell).astype(np.int64) @ (1, grid[0])
    order = np.argsort(of_point, kind="stable")
    starts = np.searchsorted(of_point[order], np.arange(grid[0] * grid[1] + 1))
    cells = row * grid[0] + column
    pair, within = _expanded(starts[cells + 1] - starts[cells])
    triangle, point = triangle[pair], order[starts[cells[pair]] + within]
    start, (across, along) = triangles[:, 0], triangles[:, 1:].transpose(1, 0, 2) - triangles[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1 / _twice_area(triangles)
        first_of, second_of = along[:, ::-1] * (1, -1) * scale[:, None], across[:, ::-1] * (-1, 1) * scale[:, None]
    offset = points[point] - start[triangle]
    first, second = (np.einsum("ni,ni->n", offset, of[triangle]) for of in (first_of, second_of))
    kept = np.flatnonzero((first > 0) & (second > 0) & (first + second < 1))
    first, second = first[kept], second[kept]
    return (triangle[kept], point[kept]), np.stack([1 - first - second, first, second], axis=1)


def _expanded(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns each index repeated by its count, and 0, 1, … within each repetition."""
    index = np.repeat(np.arange(counts.size), counts)
    return index, np.arange(index.size) - np.repeat(np.cumsum(counts) - counts, counts)
