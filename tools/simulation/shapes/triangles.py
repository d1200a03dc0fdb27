"""Surfaces of triangles: reliefs, solids of revolution and meshes; rays meet them through Embree (Wald et al. 2014).

Embree works in float32 and finds the triangle. The distance is then computed in float64 on that triangle's plane.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.files.picture_files import grey, read_picture
from counterlight.tools.simulation.shapes.parallelogram import Parallelogram
from counterlight.tools.simulation.shapes.shape import Meeting

START_GAP = 1e-4  # metres that a ray moves before it can meet a surface: float32 resolves points of a room to 1e-6


@dataclass(frozen=True, eq=False)
class Triangles:
    """A triangle mesh.

    vertices : (n, 3).
    faces : (m, 3).
    places : (n, 2). (u, v) of the vertices.
    vertex_normals : (n, 3). Unit normals to interpolate, or None for flat facets.
    grid : columns and rows of vertices, row by row in v, if the mesh is a grid over u and v; otherwise None.
    """

    vertices: FloatArray
    faces: IntArray
    places: FloatArray
    vertex_normals: FloatArray | None
    closed: bool
    grid: tuple[int, int] | None = None
    wraps: bool = False
    flat = False
    convex = False
    v_range = (0.0, 1.0)
    _embree: Any = field(init=False, repr=False, compare=False)
    facet_normals: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        across = np.cross(b - a, c - a)
        object.__setattr__(self, "facet_normals", across / np.linalg.norm(across, axis=1, keepdims=True))
        object.__setattr__(self, "_embree", _embree_scene(self.vertices, self.faces))

    @property
    def face_areas(self) -> FloatArray:
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)

    def meet(self, origins: FloatArray, directions: FloatArray) -> Meeting:
        origins = np.broadcast_to(origins, directions.shape)
        length = np.linalg.norm(directions, axis=1)
        unit = directions / length[:, None]
        starts = (origins + START_GAP * unit).astype(np.float32)
        found = self._embree.run(starts, unit.astype(np.float32), output=1)
        ray = np.flatnonzero(found["geomID"] >= 0)
        face = found["primID"][ray].astype(np.int64)
        corners, normal = self.vertices[self.faces[face]], self.facet_normals[face]
        height = np.sum((corners[:, 0] - origins[ray]) * normal, axis=1)
        distance = height / np.sum(directions[ray] * normal, axis=1)
        v, w = found["u"][ray].astype(np.float64), found["v"][ray].astype(np.float64)
        weights = np.stack([1 - v - w, v, w], axis=1)
        places = np.sum(weights[..., None] * self.places[self.faces[face]], axis=1)
        normal = self._smooth(normal, face, weights)
        return Meeting(ray, distance, places[:, 0], places[:, 1], normal, face)

    def blocks(self, starts: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        length = np.linalg.norm(directions, axis=1)
        unit = directions / length[:, None]
        origins = (np.broadcast_to(starts, directions.shape) + START_GAP * unit).astype(np.float32)
        reach = np.maximum(length - 2 * START_GAP, 0).astype(np.float32)
        found = self._embree.run(origins, unit.astype(np.float32), dists=reach, query="OCCLUDED")
        return np.asarray((found >= 0) & (reach > 0))

    def at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        return self._interpolated(self.vertices, u, v)

    def normals(self, u: FloatArray, v: FloatArray) -> FloatArray:
        assert self.vertex_normals is not None
        normal = self._interpolated(self.vertex_normals, u, v)
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))

    def density(self, u: FloatArray, v: FloatArray) -> FloatArray:
        step = 1e-3
        u, v = np.clip(u, step, 1 - step), np.clip(v, step, 1 - step)
        du = (self.at(u + step, v) - self.at(u - step, v)) / (2 * step)
        dv = (self.at(u, v + step) - self.at(u, v - step)) / (2 * step)
        return np.asarray(np.linalg.norm(np.cross(du, dv), axis=-1))

    def _smooth(self, facet: FloatArray, face: IntArray, weights: FloatArray) -> FloatArray:
        """Returns interpolated normals where they stay on the facet's side, and the facet's normal elsewhere."""
        if self.vertex_normals is None:
            return facet
        normal = np.sum(weights[..., None] * self.vertex_normals[self.faces[face]], axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return np.where(np.sum(normal * facet, axis=1, keepdims=True) > 0, normal, facet)

    def _interpolated(self, values: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
        assert self.grid is not None
        columns, rows = self.grid
        x, y = np.clip(u, 0, 1) * (columns - 1), np.clip(v, 0, 1) * (rows - 1)
        i, j = np.minimum(x.astype(np.int64), columns - 2), np.minimum(y.astype(np.int64), rows - 2)
        s, t = (x - i)[..., None], (y - j)[..., None]
        corner = values.reshape(rows, columns, 3)
        lower = corner[j, i] * (1 - s) + corner[j, i + 1] * s
        upper = corner[j + 1, i] * (1 - s) + corner[j + 1, i + 1] * s
        return np.asarray(lower * (1 - t) + upper * t)


def over_grid(points: FloatArray, keep: NDArray[np.bool_] | None, *, closed: bool, wraps: bool) -> Triangles:
    """Returns triangles between the points of a grid, v by row and u by column, with smooth normals ∂u × ∂v.

    points : (rows, columns, 3).
    keep : (rows − 1, columns − 1). Fields that belong to the surface; None for all.
    """
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    faces = np.stack([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)], axis=1)
    if keep is not None:
        faces = faces[keep.ravel()]
    faces, vertices = faces.reshape(-1, 3), points.reshape(-1, 3)
    faces = faces[_areas(vertices, faces) > 0]
    v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    normals = _vertex_normals(vertices, faces, seam=(rows, columns) if wraps else None)
    places = np.stack([u.ravel(), v.ravel()], axis=1)
    return Triangles(vertices, faces, places, normals, closed, (columns, rows), wraps)


def _areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def _vertex_normals(vertices: FloatArray, faces: IntArray, seam: tuple[int, int] | None) -> FloatArray:
    """Returns the area-weighted means of the neighbouring faces' normals (Gouraud 1971).

    seam : rows and columns of a grid whose first and last columns coincide; None without a seam.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    total = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(total, faces[:, k], across)
    if seam is not None:
        grid = total.reshape(*seam, 3)
        grid[:, 0] = grid[:, -1] = grid[:, 0] + grid[:, -1]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unused = np.array([0.0, 0.0, 1.0])
    return np.where(length > 0, total / np.where(length > 0, length, 1.0), unused)


def _embree_scene(vertices: FloatArray, faces: IntArray) -> Any:
    try:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh
    except ImportError as error:
        raise InputError(
            f"reliefs, turned solids and meshes need the package embreex ({error}); pip install embreex"
        ) from None
    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, vertices.astype(np.float32), faces.astype(np.int32))
    return scene


def turned(
    base: FloatArray, up: FloatArray, frame: tuple[FloatArray, FloatArray], profile: FloatArray, detail: int
) -> Triangles:
    """Turn a profile about an axis.

    The outside lies to the right of the outline, drawn with the radius to the right and the height up. A solid is
    therefore drawn from its bottom, up the outside, to its top. u runs around, v along the outline by its points.

    profile : (n, 2). Radius and height, in order along the outline; closed if it starts and ends on the axis.
    """
    angle = 2 * np.pi * np.linspace(0, 1, detail + 1)
    outwards = np.cos(angle)[:, None] * frame[0] + np.sin(angle)[:, None] * frame[1]
    outwards[-1] = outwards[0]
    points = base + profile[:, None, :1] * outwards[None] + profile[:, None, 1:] * up
    closed = bool(profile[0, 0] == 0 and profile[-1, 0] == 0)
    # ∂u × ∂v points outwards: u runs counterclockwise about the axis.
    return over_grid(points, None, closed=closed, wraps=True)


MAX_HEIGHTS = 1 << 26


def relief(base: Parallelogram, heights: FloatArray, *, cut: bool) -> Triangles:
    """Returns a surface with heights over a parallelogram.

    heights : (rows, columns), metres above the base, row 0 at v = 0.
    cut : omit the parts that do not rise above 0.
    """
    rows, columns = heights.shape
    u, v = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    points = base.at(u, v) + heights[..., None] * base.normal
    keep = None
    if cut:
        keep = (heights[:-1, :-1] > 0) | (heights[:-1, 1:] > 0) | (heights[1:, :-1] > 0) | (heights[1:, 1:] > 0)
    if np.cross(base.edge_u, base.edge_v) @ base.normal < 0:  # the grid's normals must agree with the base's normal
        points = points[:, ::-1]
        keep = None if keep is None else keep[:, ::-1]
    return over_grid(points, keep, closed=False, wraps=False)


def read_heights(path: Path, where: str, columns: int, rows: int) -> FloatArray:
    """Read a grey picture as heights (rows, columns).

    The picture has 8 or 16 bits, white is 1, black is 0, and its bottom row is at v = 0.
    """
    try:
        picture = grey(read_picture(path, MAX_HEIGHTS, upright=True))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    heights = picture.astype(np.float64) / np.iinfo(picture.dtype).max
    return np.asarray(cv2.resize(heights, (columns, rows), interpolation=cv2.INTER_AREA)[::-1], np.float64)
