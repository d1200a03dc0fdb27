"""Diffuse inter-reflection, all bounces, between cells of the surfaces (radiosity; Goral et al. 1984).

With E the direct irradiance on the cells and F the form factors, the radiosity is B = ρ (E + F B). The indirect
irradiance is H = F B = F (I − diag(ρ) F)⁻¹ diag(ρ) E = M E. The camera sees ρ H / π, with H interpolated between the
centres of the cells of the visible surface. Together: far light = U M D with E = D p (T = C (I − K)⁻¹ P, factored).

Form factors between planes are exact for points (Lambert 1760). Form factors with curved surfaces are sums over points.
Surfaces have one side here, the side that their normals point to. Clear solids do not take part.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.simulation.cells import Grid, cut_into_cells, spread_places
from counterlight.tools.simulation.geometry import blocked
from counterlight.tools.simulation.paths import Deposits, Samples
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.simulation.shapes.parallelogram import Parallelogram
from counterlight.tools.simulation.surfaces import Surface
from counterlight.tools.transport.transport import Csr, Dense, FarLight, stacked

ALBEDO_POINTS = 8  # points per axis and cell
Entries = tuple[IntArray, IntArray, FloatArray]
NEAR = 4  # cell sizes; beyond, the centre represents a cell within half a per cent
PAIRS_AT_ONCE = 1 << 21


@dataclass(frozen=True)
class Exchange:
    """The far light's factors that do not depend on the camera.

    gather : D, (cells, projector pixels).
    mix : M, (3, cells, cells).
    """

    grids: tuple[Grid, ...]
    gather: SparseRows
    mix: FloatArray

    @property
    def cells(self) -> int:
        return int(self.mix.shape[1])

    def far_light(self, scatter: SparseRows) -> FarLight:
        return FarLight(self.gather, Dense(self.mix), scatter)


def prepare(scene: Scene, deposits: Iterable[Deposits]) -> Exchange:
    """Returns the cells, the light that lands on them, and their exchange."""
    grids = cut_into_cells(scene.surfaces, scene.cells)
    albedo = np.concatenate([mean_albedo(grid) for grid in grids])
    factors = form_factors(scene.surfaces, grids)
    return Exchange(tuple(grids), _gather(scene, grids, deposits), mixed(factors, albedo))


def seen_by_camera(scene: Scene, exchange: Exchange, samples: Samples, matt: FloatArray) -> list[Entries]:
    """Returns U's entries for some samples: camera pixel, cell, radiance per indirect irradiance on the cell (n, 3).

    matt : (n, 3). Radiance in a pixel per irradiance at the samples.
    """
    parts = []
    for grid in exchange.grids:
        on = np.flatnonzero((samples.surface == scene.surfaces.index(grid.surface)) & samples.front)
        if on.size:
            some = samples.at(on)
            for cell, weight in grid.between(some):
                has = weight > 0
                parts.append((some.pixel[has], cell[has], matt[on][has] * weight[has, None]))
    return parts


def mixed(factors: FloatArray, albedo: FloatArray) -> FloatArray:
    """Returns M = F (I − diag(ρ) F)⁻¹ diag(ρ) per channel, (3, cells, cells).

    factors : F, (cells, cells).
    albedo : ρ, (cells, 3).
    """
    identity = np.eye(len(factors))
    parts = []
    for i in range(3):
        reflected = albedo[:, i, None] * factors
        parts.append(factors @ np.linalg.solve(identity - reflected, np.diag(albedo[:, i])))
    return np.stack(parts)


def form_factors(surfaces: tuple[Surface, ...], grids: list[Grid]) -> FloatArray:
    """Returns F (cells, cells): F[i, j] is the share of light from cell i that reaches cell j; 0 if occluded."""
    count = sum(grid.count for grid in grids)
    result = np.zeros((count, count))
    opaque = tuple(surface for surface in surfaces if surface.matt)
    for index, receiver in enumerate(grids):
        for emitter in grids[index:]:
            if receiver.surface.shape.flat and emitter.surface.shape.flat:
                if emitter is not receiver:
                    result[receiver.numbers, emitter.numbers] = _between_planes(opaque, receiver, emitter)
                    result[emitter.numbers, receiver.numbers] = _between_planes(opaque, emitter, receiver)
            elif emitter is not receiver or not receiver.surface.shape.convex:
                exchange = _exchange(opaque, receiver, emitter)
                result[receiver.numbers, emitter.numbers] = _per_area(exchange, receiver.areas)
                result[emitter.numbers, receiver.numbers] = _per_area(exchange.T, emitter.areas)
    # no cell returns more light than it receives
    return np.asarray(result / np.maximum(result.sum(axis=1, keepdims=True), 1))


def point_to_polygon(points: FloatArray, normal: FloatArray, outlines: FloatArray) -> FloatArray:
    """Returns form factors (n,) from small areas at points to one polygon each.

    F = 1/2π |Σ_k β_k n · (r_k × r_{k+1}) / |r_k × r_{k+1}|| (Lambert 1760). Polygon corners below the horizon of a
    point are raised onto it.

    points : (n, 3).
    normal : (3,), shared by all points.
    outlines : (n, corners, 3).
    """
    r = outlines - points[:, None]
    r = r - np.minimum(r @ normal, 0)[..., None] * normal
    corners = [r[:, k] for k in range(r.shape[1])]
    total = np.zeros(len(points))
    for this, following in zip(corners, corners[1:] + corners[:1], strict=True):
        across = np.cross(this, following)
        size = np.sqrt(np.einsum("ij,ij->i", across, across))
        angle = np.arctan2(size, np.einsum("ij,ij->i", this, following))
        total += np.divide(angle * (across @ normal), size, out=np.zeros_like(size), where=size > 0)
    return np.asarray(np.abs(total) / (2 * np.pi))


def mean_albedo(grid: Grid) -> FloatArray:
    """Returns the mean albedo of each cell, (cells, 3)."""
    material = grid.surface.material
    if not isinstance(grid.surface.shape, Parallelogram):
        return np.asarray(np.sum(grid.share[..., None] * material.albedo(grid.u, grid.v), axis=1))
    return np.asarray(material.albedo(*spread_places(grid.across, grid.along, ALBEDO_POINTS)).mean(axis=1))


def _between_planes(surfaces: tuple[Surface, ...], receiver: Grid, emitter: Grid) -> FloatArray:
    """Returns form factors from one point per receiving cell, or from all its points if the emitting cell is near."""
    i, j = np.nonzero(np.outer(_in_front_of(receiver, emitter), _in_front_of(emitter, receiver)))
    starts, ends = _centres(receiver), _centres(emitter)
    others = tuple(s for s in surfaces if s is not receiver.surface and s is not emitter.surface)
    seen = ~blocked(starts[i], ends[j], others)
    i, j = i[seen], j[seen]
    outlines, normal = emitter.outlines(), receiver.normals[0, 0]
    size = np.sqrt(max(receiver.areas.max(), emitter.areas.max()))
    near = np.linalg.norm(starts[i] - ends[j], axis=1) < NEAR * size
    factors = np.zeros((receiver.count, emitter.count))
    factors[i[~near], j[~near]] = point_to_polygon(starts[i[~near]], normal, outlines[j[~near]])
    i, j = i[near], j[near]
    for k in range(receiver.points.shape[1]):
        factors[i, j] += point_to_polygon(receiver.points[i, k], normal, outlines[j]) / receiver.points.shape[1]
    return factors


def _in_front_of(cells: Grid, judge: Grid) -> NDArray[np.bool_]:
    """Returns the mask of the cells whose centre is in front of the other grid's plane."""
    return np.asarray((_centres(cells) - judge.points[0, 0]) @ judge.normals[0, 0] > 0)


def _centres(grid: Grid) -> FloatArray:
    return np.asarray(np.sum(grid.share[..., None] * grid.points, axis=1))


def _exchange(surfaces: tuple[Surface, ...], first: Grid, second: Grid) -> FloatArray:
    """Returns A_i F_ij, (first cells, second cells).

    Each value is the sum of a_p a_q cos θ_p cos θ_q / (π r² + (a_p + a_q)/2) over visible pairs of points. The areas in
    the denominator keep the sum finite for near points, as for a disc (Wallace et al. 1989).
    """
    result = np.zeros((first.count, second.count))
    areas_p, areas_q = first.share * first.areas[:, None], second.share * second.areas[:, None]
    rows = max(1, PAIRS_AT_ONCE // areas_q.size)
    for k in range(areas_p.shape[1]):
        for top in range(0, first.count, rows):
            cells = slice(top, top + rows)
            p, normal_p, a_p = first.points[cells, k], first.normals[cells, k], areas_p[cells, k]
            between = second.points[None] - p[:, None, None]
            square = np.sum(between**2, axis=-1)
            leaves = np.sum(between * normal_p[:, None, None], axis=-1)
            arrives = -np.sum(between * second.normals[None], axis=-1)
            small = np.pi * square + (a_p[:, None, None] + areas_q[None]) / 2
            facing = np.maximum(leaves, 0) * np.maximum(arrives, 0)
            kernel = np.divide(facing, square * small, out=np.zeros_like(facing), where=facing > 0)
            kernel *= a_p[:, None, None] * areas_q[None]
            _take_hidden(surfaces, kernel, p, second.points)
            result[cells] += kernel.sum(axis=-1)
    return result


def _take_hidden(surfaces: tuple[Surface, ...], kernel: FloatArray, starts: FloatArray, ends: FloatArray) -> None:
    """Set pairs of points that do not see each other to 0, in place."""
    i, j, k = np.nonzero(kernel > 1e-3 * kernel.mean())
    hidden = blocked(starts[i], ends[j, k], surfaces)
    kernel[i[hidden], j[hidden], k[hidden]] = 0


def _per_area(exchange: FloatArray, areas: FloatArray) -> FloatArray:
    return np.divide(exchange, areas[:, None], out=np.zeros_like(exchange), where=areas[:, None] > 0)


def _gather(scene: Scene, grids: list[Grid], deposits: Iterable[Deposits]) -> SparseRows:
    """Returns D: irradiance on each cell per unit drive of each projector pixel, i.e. landed flux per cell area."""
    shape = grids[-1].first + grids[-1].count, scene.projector.pixels
    cells, pixels, values = [], [], []
    for batch in deposits:
        for grid in grids:
            on = np.flatnonzero((batch.surface == scene.surfaces.index(grid.surface)) & batch.front)
            if on.size:
                cell = grid.cell_at(batch.at(on))
                cells.append(cell)
                pixels.append(batch.pixel[on])
                values.append(batch.flux[on] / grid.areas[cell - grid.first, None])
    if not values:
        return stacked([Csr(shape)] * 3)
    places = np.concatenate(cells), np.concatenate(pixels)
    alike = all(value.shape[1] == 1 for value in values)
    found = np.concatenate(values if alike else [np.broadcast_to(value, (len(value), 3)) for value in values])
    matrices = [Csr((column, places), shape=shape) for column in found.T]
    return stacked(matrices * 3 if alike else matrices)
