"""Diffuse inter-reflection, all bounces, between cells of the surfaces (radiosity; Goral et al. 1984).

With E the direct irradiance on the cells and F the form factors, the radiosity is B = ρ (E + F B), and what arrives
indirectly is H = F B = F (I − diag(ρ) F)⁻¹ diag(ρ) E = M E. The camera sees ρ H / π, H interpolated between the centres
of the cells of the surface that it looks at. Together: far light = U M D with E = D p (T = C (I − K)⁻¹ P, factored).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tools.simulation.geometry import blocked, pixel_rays, trace
from tools.simulation.scene import Scene, Surface
from tools.simulation.view import CameraView
from tools.transport.transport import Csr, FarLight

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
POINTS = 3  # sample points an axis and cell for form factors
BEAMS = 2  # rays an axis and projector pixel for the direct light on cells
ALBEDO_POINTS = 8  # an axis and cell
BAND_RAYS = 1 << 19  # rays traced at once


@dataclass(frozen=True)
class Grid:
    """A surface's cells: across u and along v; `first` is the number of its first cell."""

    surface: Surface
    across: int
    along: int
    first: int

    @property
    def count(self) -> int:
        return self.across * self.along

    @property
    def cell_area(self) -> float:
        return self.surface.area / self.count

    def points(self, side: int) -> FloatArray:
        """side × side evenly spread points of every cell: (cells, side², 3)."""
        u, v = self.coordinates(side)
        return self.surface.at(u, v)

    def coordinates(self, side: int) -> tuple[FloatArray, FloatArray]:
        """u and v of those points, (cells, side²) each."""
        offset = (np.arange(side) + 0.5) / side
        j, i, b, a = np.meshgrid(np.arange(self.along), np.arange(self.across), offset, offset, indexing="ij")
        shape = self.count, side**2
        u, v = (i + a) / self.across, (j + b) / self.along
        return u.reshape(shape).astype(np.float64), v.reshape(shape).astype(np.float64)

    def outlines(self) -> FloatArray:
        """Corners of every cell, in order around it: (cells, 4, 3)."""
        j, i = np.meshgrid(np.arange(self.along), np.arange(self.across), indexing="ij")
        corners = [(i + a, j + b) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
        return np.stack([self.surface.at(x.ravel() / self.across, y.ravel() / self.along) for x, y in corners], axis=1)


def far_light(scene: Scene, view: CameraView) -> FarLight:
    """The inter-reflected light of a scene as factors; see the module's text."""
    grids = cut_into_cells(scene)
    factors = form_factors(scene, grids)
    albedo = np.concatenate([_mean_albedo(grid) for grid in grids])
    gather = _gather(scene, grids)
    return FarLight((gather,) * 3, mixed(factors, albedo), _scatter(scene, view, grids))


def cut_into_cells(scene: Scene) -> list[Grid]:
    """Nearly square cells of nearly one size, about scene.cells together."""
    total = sum(surface.area for surface in scene.surfaces)
    side = np.sqrt(total / scene.cells)
    grids: list[Grid] = []
    for surface in scene.surfaces:
        lengths = np.linalg.norm(surface.edge_u), np.linalg.norm(surface.edge_v)
        across, along = (max(1, round(float(length / side))) for length in lengths)
        grids.append(Grid(surface, across, along, sum(grid.count for grid in grids)))
    return grids


def mixed(factors: FloatArray, albedo: FloatArray) -> FloatArray:
    """M = F (I − diag(ρ) F)⁻¹ diag(ρ) per channel: (3, cells, cells); albedo (cells, 3)."""
    identity = np.eye(len(factors))
    parts = []
    for i in range(3):
        reflected = albedo[:, i, None] * factors
        parts.append(factors @ np.linalg.solve(identity - reflected, np.diag(albedo[:, i])))
    return np.stack(parts)


def form_factors(scene: Scene, grids: list[Grid]) -> FloatArray:
    """F[i, j], the share of what leaves cell i that reaches cell j, (cells, cells); occluded pairs are 0."""
    count = sum(grid.count for grid in grids)
    result = np.zeros((count, count))
    for receiver in grids:
        for emitter in grids:
            if emitter is not receiver:
                rows = slice(receiver.first, receiver.first + receiver.count)
                columns = slice(emitter.first, emitter.first + emitter.count)
                result[rows, columns] = _between(scene, receiver, emitter)
    return result


def point_to_polygon(points: FloatArray, normal: FloatArray, outlines: FloatArray) -> FloatArray:
    """Form factors from small areas at points (n, 3), all with one normal, to polygons (m, corners, 3): (n, m).

    F = 1/2π |Σ_k β_k n · (r_k × r_{k+1}) / |r_k × r_{k+1}|| (Lambert 1760). Corners below the horizon of a point are
    raised onto it.
    """
    r = outlines[None] - points[:, None, None, :]
    height = r @ normal
    r = r - np.minimum(height, 0)[..., None] * normal
    following = np.roll(r, -1, axis=2)
    across = np.cross(r, following)
    size = np.linalg.norm(across, axis=-1)
    angle = np.arctan2(size, np.sum(r * following, axis=-1))
    share = np.divide(angle * (across @ normal), size, out=np.zeros_like(size), where=size > 0)
    return np.asarray(np.abs(share.sum(axis=-1)) / (2 * np.pi))


def _between(scene: Scene, receiver: Grid, emitter: Grid) -> FloatArray:
    points, outlines = receiver.points(POINTS), emitter.outlines()
    factors = np.zeros((receiver.count, emitter.count))
    for k in range(points.shape[1]):
        factors += point_to_polygon(points[:, k], receiver.surface.normal, outlines) / points.shape[1]
    factors[:, ~_in_front_of(emitter, receiver)] = 0
    factors[~_in_front_of(receiver, emitter)] = 0
    others = tuple(s for s in scene.surfaces if s is not receiver.surface and s is not emitter.surface)
    if others:
        factors[_hidden(receiver, emitter, others)] = 0
    return factors


def _in_front_of(cells: Grid, judge: Grid) -> NDArray[np.bool_]:
    """Which cells have their centre in front of the other grid's plane."""
    centres = cells.points(1)[:, 0]
    return np.asarray((centres - judge.surface.corner) @ judge.surface.normal > 0)


def _hidden(receiver: Grid, emitter: Grid, others: tuple[Surface, ...]) -> NDArray[np.bool_]:
    starts, ends = receiver.points(1)[:, 0], emitter.points(1)[:, 0]
    pairs = np.repeat(starts, len(ends), axis=0), np.tile(ends, (len(starts), 1))
    return blocked(*pairs, others).reshape(len(starts), len(ends))


def _gather(scene: Scene, grids: list[Grid]) -> Csr:
    """D: irradiance on each cell per unit drive of each projector pixel, (cells, projector pixels).

    Under the even light of effects/direct.py every projector pixel carries the same flux, π·brightness·z₀² times its
    solid area at depth 1, wherever it lands; a cell's irradiance is the flux that lands on it by its area.
    """
    projector = scene.projector
    pitch_area = 4 * projector.tan_half[0] * projector.tan_half[1] / (projector.width * projector.height)
    flux = np.pi * scene.brightness * projector.target_distance**2 * pitch_area / BEAMS**2
    starts = np.array([grid.first for grid in grids])
    areas = np.array([grid.cell_area for grid in grids])
    facing = np.array([(projector.position - grid.surface.corner) @ grid.surface.normal > 0 for grid in grids])
    sizes = np.array([(grid.across, grid.along) for grid in grids])
    parts = []
    height = max(1, BAND_RAYS // (projector.width * BEAMS**2))
    for top in range(0, projector.height, height):
        rows = range(top, min(top + height, projector.height))
        directions, pixels = pixel_rays(projector, rows, BEAMS)
        hits = trace(projector.position, directions, scene.surfaces)
        lands = (hits.surface >= 0) & facing[hits.surface]
        surface = hits.surface[lands]
        across, along = sizes[surface].T
        i = np.minimum((hits.u[lands] * across).astype(np.int64), across - 1)
        j = np.minimum((hits.v[lands] * along).astype(np.int64), along - 1)
        parts.append((flux / areas[surface], starts[surface] + j * across + i, pixels[lands]))
    values, cell, pixel = (np.concatenate(part) for part in zip(*parts, strict=True))
    shape = int(starts[-1] + grids[-1].count), projector.width * projector.height
    return sparse.csr_array((values, (cell, pixel)), shape=shape)


def _scatter(scene: Scene, view: CameraView, grids: list[Grid]) -> tuple[Csr, ...]:
    """U: radiance of each camera pixel per indirect irradiance on each cell, (camera pixels, cells) per channel."""
    by_name = {id(grid.surface): grid for grid in grids}
    shape = scene.camera.width * scene.camera.height, sum(grid.count for grid in grids)
    total = [sparse.csr_array(shape) for _ in range(3)]
    for (pixels, surface, _, albedo), (u, v) in zip(view.patches(), view.places(), strict=True):
        grid = by_name[id(surface)]
        for cell, weight in _bilinear(grid, u, v):
            seen = albedo * (weight / np.pi / scene.samples**2)[:, None]
            for i in range(3):
                total[i] = total[i] + sparse.csr_array((seen[:, i], (pixels, cell)), shape=shape)
    return tuple(total)


def _bilinear(grid: Grid, u: FloatArray, v: FloatArray) -> list[tuple[IntArray, FloatArray]]:
    """The four cells whose centres surround a place, and their weights; beyond the outer centres, the outer ones."""
    x = np.clip(u * grid.across - 0.5, 0, grid.across - 1)
    y = np.clip(v * grid.along - 0.5, 0, grid.along - 1)
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    share_x, share_y = x - i, y - j
    i1, j1 = np.minimum(i + 1, grid.across - 1), np.minimum(j + 1, grid.along - 1)
    return [
        (grid.first + j * grid.across + i, (1 - share_x) * (1 - share_y)),
        (grid.first + j * grid.across + i1, share_x * (1 - share_y)),
        (grid.first + j1 * grid.across + i, (1 - share_x) * share_y),
        (grid.first + j1 * grid.across + i1, share_x * share_y),
    ]


def _mean_albedo(grid: Grid) -> FloatArray:
    u, v = grid.coordinates(ALBEDO_POINTS)
    return np.asarray(grid.surface.material.albedo(u, v).mean(axis=1))
