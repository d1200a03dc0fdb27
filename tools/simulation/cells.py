"""Surfaces cut into cells for the far light: points per cell, the cell of a place, and neighbouring cells."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.simulation.paths import Deposits, Samples
from counterlight.tools.simulation.shapes.parallelogram import Parallelogram
from counterlight.tools.simulation.shapes.shape import Shape, shape_area
from counterlight.tools.simulation.shapes.triangles import Triangles
from counterlight.tools.simulation.surfaces import Surface

Shares = list[tuple[IntArray, FloatArray]]
POINTS = 3  # points per axis and cell
NEAREST = 4  # number of cells that a point is interpolated from, on a mesh without a grid
TURN = 0.7  # distance between two points of a mesh, in cell sizes, that a right angle between their normals adds


@dataclass(frozen=True)
class Grid:
    """Cells of a surface that is a grid over u and v, across u and along v.

    first : number of the first cell.
    points, normals : (cells, k, 3).
    u, v : (cells, k).
    share : (cells, k). The points' shares of the cell's area; they sum to 1, or to 0 in a cell without surface.
    areas : (cells,).
    of_facet : (facets,). The cell that each triangle belongs to; None for shapes without triangles.
    """

    surface: Surface
    across: int
    along: int
    first: int
    points: FloatArray
    normals: FloatArray
    u: FloatArray
    v: FloatArray
    share: FloatArray
    areas: FloatArray
    of_facet: IntArray | None

    @property
    def count(self) -> int:
        return self.across * self.along

    @property
    def numbers(self) -> slice:
        return slice(self.first, self.first + self.count)

    def outlines(self) -> FloatArray:
        """Returns the corners of every cell of a plane, in order around it: (cells, 4, 3)."""
        j, i = np.meshgrid(np.arange(self.along), np.arange(self.across), indexing="ij")
        corners = [((i + a).ravel() / self.across, (j + b).ravel() / self.along) for a, b in OUTLINE]
        return np.stack([self.surface.shape.at(u, v) for u, v in corners], axis=1)

    def cell_at(self, there: Samples | Deposits) -> IntArray:
        """Returns the numbers of the cells that hold points of this surface."""
        if self.of_facet is not None:
            return np.asarray(self.first + self.of_facet[there.facet])
        i = np.clip((there.u * self.across).astype(np.int64), 0, self.across - 1)
        j = np.clip(np.floor(self._height(there.v) * self.along).astype(np.int64), 0, self.along - 1)
        return np.asarray(self.first + j * self.across + i)

    def between(self, there: Samples | Deposits) -> Shares:
        """Returns the four cells whose centres surround a place, and their bilinear weights.

        Places beyond the outermost centres are clamped to them. Cells without surface have weight 0.
        """
        wraps, last = self.surface.shape.wraps, self.across - 1
        x = there.u * self.across - 0.5 if wraps else np.clip(there.u * self.across - 0.5, 0, last)
        y = np.clip(self._height(there.v) * self.along - 0.5, 0, self.along - 1)
        i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        s, t = x - i, y - j
        i0, i1 = (i % self.across, (i + 1) % self.across) if wraps else (i, np.minimum(i + 1, last))
        j1 = np.minimum(j + 1, self.along - 1)
        places = [j * self.across + i0, j * self.across + i1, j1 * self.across + i0, j1 * self.across + i1]
        weights: FloatArray = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t])
        weights *= self.areas[np.stack(places)] > 0
        total = weights.sum(axis=0)
        weights = np.divide(weights, total, out=np.zeros_like(weights), where=total > 0)
        return [(self.first + place, weight) for place, weight in zip(places, weights, strict=True)]

    def _height(self, v: FloatArray) -> FloatArray:
        low, high = self.surface.shape.v_range
        return np.asarray((v - low) / (high - low))


@dataclass(frozen=True)
class Clumps(Grid):
    """Cells of a mesh without a grid: faces grouped by position and direction; `across` cells, `along` is 1."""

    tree: cKDTree
    size: float

    def between(self, there: Samples | Deposits) -> Shares:
        near = min(NEAREST, self.count)
        found = self.tree.query(clump_key(there.point, there.normal, self.size), k=[*range(1, near + 1)])
        distance, cell = np.asarray(found[0], np.float64), np.asarray(found[1], np.int64)
        weights = 1 / (distance + 1e-3 * self.size) ** 2  # Shepard 1968
        weights /= weights.sum(axis=1, keepdims=True)
        return [(self.first + cell[:, k], weights[:, k]) for k in range(near)]


OUTLINE = ((0, 0), (1, 0), (1, 1), (0, 1))


def cut_into_cells(surfaces: Sequence[Surface], cells: int) -> list[Grid]:
    """Cut surfaces into nearly square cells of nearly equal size, about `cells` in total; clear solids have none."""
    matt = [surface for surface in surfaces if surface.matt]
    side = float(np.sqrt(sum(area_of(surface.shape) for surface in matt) / cells))
    grids: list[Grid] = []
    for surface in matt:
        first = sum(grid.count for grid in grids)
        shape = surface.shape
        if isinstance(shape, Triangles):
            grids.append(_of_faces(surface, shape, side, first))
        else:
            grids.append(_of_places(surface, side, first))
    return grids


def spread_places(across: int, along: int, side: int) -> tuple[FloatArray, FloatArray]:
    """Returns side × side evenly spread places per cell of a grid on the unit square: u, v, (cells, side²) each."""
    offset = (np.arange(side) + 0.5) / side
    j, i, b, a = np.meshgrid(np.arange(along), np.arange(across), offset, offset, indexing="ij")
    shape = across * along, side**2
    return ((i + a) / across).reshape(shape).astype(np.float64), ((j + b) / along).reshape(shape).astype(np.float64)


def area_of(shape: Shape) -> float:
    return float(shape.face_areas.sum()) if isinstance(shape, Triangles) else shape_area(shape)


def clump_key(point: FloatArray, normal: FloatArray, size: float) -> FloatArray:
    """Returns points and directions in one space of six dimensions, metres."""
    return np.concatenate([point, TURN * size * normal], axis=1)


def _of_places(surface: Surface, side: float, first: int) -> Grid:
    """Cells of equal steps in u and v, with POINTS × POINTS points per cell at the centres of its thirds."""
    shape = surface.shape
    across, along = _counts(shape, side)
    low, high = shape.v_range
    u, height = spread_places(across, along, POINTS)
    v = low + (high - low) * height
    density = shape.density(u, v)
    areas = density.mean(axis=1) * (high - low) / (across * along)
    share = density / density.sum(axis=1, keepdims=True)
    return Grid(surface, across, along, first, shape.at(u, v), shape.normals(u, v), u, v, share, areas, None)


def _counts(shape: Shape, side: float) -> tuple[int, int]:
    if isinstance(shape, Parallelogram):
        lengths = np.linalg.norm(shape.edge_u), np.linalg.norm(shape.edge_v)
    else:
        lengths = _middle_lines(shape)
    across, along = (max(1, round(float(length) / side)) for length in lengths)
    return across, along


def _middle_lines(shape: Shape) -> tuple[np.floating[Any], np.floating[Any]]:
    """Returns the length of a surface along u at its middle v, and its length along v."""
    low, high = shape.v_range
    steps = np.linspace(0, 1, 65)
    around = shape.at(steps, np.full(65, (low + high) / 2))
    along = shape.at(np.full(65, 0.25), low + (high - low) * steps)
    u, v = (np.sum(np.linalg.norm(np.diff(line, axis=0), axis=1)) for line in (around, along))
    return u, v


def _of_faces(surface: Surface, shape: Triangles, side: float, first: int) -> Grid:
    """Group faces into cells; POINTS² faces that represent a cell are spread over it by area."""
    corners = shape.vertices[shape.faces]
    centres, places = corners.mean(axis=1), shape.places[shape.faces].mean(axis=1)
    normals = shape.facet_normals
    if shape.grid is not None:
        across, along = _grid_counts(shape, side)
        i = np.minimum((places[:, 0] * across).astype(np.int64), across - 1)
        cell = np.minimum((places[:, 1] * along).astype(np.int64), along - 1) * across + i
    else:
        keys = np.concatenate([centres / side, normals / (2 * TURN)], axis=1)
        _, cell = np.unique(np.round(keys).astype(np.int64), axis=0, return_inverse=True)
        across, along = int(cell.max()) + 1, 1
    chosen, share, areas = _representatives(cell, across * along, shape.face_areas)
    fields = (surface, across, along, first, centres[chosen], normals[chosen], places[chosen, 0], places[chosen, 1])
    if shape.grid is not None:
        return Grid(*fields, share, areas, cell)
    middle = np.sum(share[..., None] * centres[chosen], axis=1)
    facing = np.sum(share[..., None] * normals[chosen], axis=1)
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-12)
    tree = cKDTree(clump_key(middle, facing, side))
    return Clumps(*fields, share, areas, cell, tree, side)


def _grid_counts(shape: Triangles, side: float) -> tuple[int, int]:
    assert shape.grid is not None
    columns, rows = shape.grid
    grid = shape.vertices.reshape(rows, columns, 3)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2).sum(axis=1).mean()
    along = np.linalg.norm(np.diff(grid, axis=0), axis=2).sum(axis=0).mean()
    count = shape.face_areas.sum() / side**2
    wide = max(1, round(float(np.sqrt(count * across / along))))
    return wide, max(1, round(float(count / wide)))


def _representatives(cell: IntArray, count: int, face_areas: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Returns POINTS² faces per cell at equal steps of its area, their shares, and the areas of the cells."""
    order = np.argsort(cell, kind="stable")
    areas = np.bincount(cell, face_areas, count)
    before = np.concatenate([[0.0], np.cumsum(face_areas[order])])
    start = np.concatenate([[0.0], np.cumsum(areas)])[:-1]
    steps = (np.arange(POINTS**2) + 0.5) / POINTS**2
    target = start[:, None] + steps * areas[:, None]
    index = np.clip(np.searchsorted(before, target, side="right") - 1, 0, len(order) - 1)
    share = np.repeat(np.where(areas > 0, 1 / POINTS**2, 0.0)[:, None], POINTS**2, axis=1)
    return order[index], share, np.asarray(areas, np.float64)
