"""Rays and where they go: from pixels into the room, from points into a projector's picture."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tools.simulation.scene import Pinhole, Surface

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
PARALLEL, TOO_CLOSE = 1e-12, 1e-9


@dataclass(frozen=True)
class Hits:
    """Where rays end: the surface's index (−1 for none) and the place (u, v) on it, (rays,) each."""

    surface: IntArray
    u: FloatArray
    v: FloatArray


def pixel_rays(device: Pinhole, rows: range, samples: int) -> tuple[FloatArray, IntArray]:
    """Directions (rays, 3), not normalised, of samples × samples rays through each pixel of some rows, and its index.

    The depth of a direction along the axis is 1.
    """
    offset = (np.arange(samples) + 0.5) / samples
    y, x, sy, sx = np.meshgrid(np.array(rows), np.arange(device.width), offset, offset, indexing="ij")
    tan_x, tan_y = device.tan_half
    across = (2 * (x + sx) / device.width - 1).ravel() * tan_x
    down = (2 * (y + sy) / device.height - 1).ravel() * tan_y
    directions = device.forward + across[:, None] * device.right - down[:, None] * device.up
    return directions, (y * device.width + x).ravel()


def trace(origin: FloatArray, directions: FloatArray, surfaces: tuple[Surface, ...]) -> Hits:
    """The nearest surface along each ray; origin is (3,) or (rays, 3)."""
    count = len(directions)
    nearest = np.full(count, np.inf)
    hits = Hits(np.full(count, -1, np.int64), np.zeros(count), np.zeros(count))
    for index, surface in enumerate(surfaces):
        distance, u, v = _meet(origin, directions, surface)
        inside = (distance > TOO_CLOSE) & (distance < nearest) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
        nearest[inside] = distance[inside]
        hits.surface[inside], hits.u[inside], hits.v[inside] = index, u[inside], v[inside]
    return hits


def blocked(starts: FloatArray, ends: FloatArray, surfaces: tuple[Surface, ...]) -> NDArray[np.bool_]:
    """Which segments (n, 3) -> (n, 3) or (3,) are cut by a surface strictly between their ends."""
    directions = ends - starts
    result = np.zeros(len(directions), bool)
    for surface in surfaces:
        distance, u, v = _meet(starts, directions, surface)
        inside = (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
        result |= inside & (distance > 1e-6) & (distance < 1 - 1e-6)
    return result


def project(device: Pinhole, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pixel coordinates x, y (continuous) and depth along the axis of points (n, 3)."""
    towards = points - device.position
    depth = towards @ device.forward
    safe = np.where(depth > 0, depth, np.nan)
    x = (towards @ device.right / safe / device.tan_half[0] + 1) * device.width / 2
    y = (1 - towards @ device.up / safe / device.tan_half[1]) * device.height / 2
    return x, y, depth


def pixel_at(device: Pinhole, x: FloatArray, y: FloatArray) -> IntArray:
    """Index of the pixel that contains (x, y); −1 outside the picture or behind the device."""
    inside = (x >= 0) & (x < device.width) & (y >= 0) & (y < device.height)  # False for NaN
    column = np.where(inside, x, 0).astype(np.int64)
    row = np.where(inside, y, 0).astype(np.int64)
    return np.where(inside, row * device.width + column, -1)


def _meet(origin: FloatArray, directions: FloatArray, surface: Surface) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Distance in units of the direction, and (u, v) in the surface's plane; infinite distance when parallel."""
    towards = directions @ surface.normal
    parallel = np.abs(towards) < PARALLEL
    height = (surface.corner - origin) @ surface.normal
    distance = np.where(parallel, np.inf, height / np.where(parallel, 1.0, towards))
    reach = np.where(np.isfinite(distance), distance, 0.0)
    place = origin + reach[:, None] * directions - surface.corner
    # Solve place = u·edge_u + v·edge_v in the plane by its 2×2 Gram matrix.
    uu, uv, vv = (float(a @ b) for a, b in _pairs(surface))
    pu, pv = place @ surface.edge_u, place @ surface.edge_v
    determinant = uu * vv - uv * uv
    return distance, (pu * vv - pv * uv) / determinant, (pv * uu - pu * uv) / determinant


def _pairs(surface: Surface) -> tuple[tuple[FloatArray, FloatArray], ...]:
    u, v = surface.edge_u, surface.edge_v
    return (u, u), (u, v), (v, v)
