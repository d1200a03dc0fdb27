"""Flat surfaces: corner + u·edge_u + v·edge_v."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.shapes.shape import TOO_CLOSE, Meeting

PARALLEL = 1e-12


@dataclass(frozen=True, eq=False)
class Parallelogram:
    """A flat surface; `normal` is a unit vector. Both sides reflect light."""

    corner: FloatArray
    edge_u: FloatArray
    edge_v: FloatArray
    normal: FloatArray
    flat = True
    closed = False
    convex = True
    v_range = (0.0, 1.0)
    wraps = False

    @property
    def area(self) -> float:
        return float(np.linalg.norm(np.cross(self.edge_u, self.edge_v)))

    @property
    def corners(self) -> FloatArray:
        """Returns the corners (4, 3), in order around the outline."""
        return self.at(np.array([0.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0]))

    def meet(self, origins: FloatArray, directions: FloatArray) -> Meeting:
        distance, u, v = self._cut(origins, directions)
        ray = np.flatnonzero((distance > TOO_CLOSE) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1))
        normal = np.broadcast_to(self.normal, (ray.size, 3))
        return Meeting(ray, distance[ray], u[ray], v[ray], normal, np.full(ray.size, -1))

    def blocks(self, starts: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        distance, u, v = self._cut(starts, directions)
        inside = (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
        return np.asarray(inside & (distance > TOO_CLOSE) & (distance < 1 - TOO_CLOSE))

    def at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        return np.asarray(self.corner + np.asarray(u)[..., None] * self.edge_u + np.asarray(v)[..., None] * self.edge_v)

    def normals(self, u: FloatArray, v: FloatArray) -> FloatArray:
        return np.broadcast_to(self.normal, (*np.shape(u), 3))

    def density(self, u: FloatArray, v: FloatArray) -> FloatArray:
        return np.full(np.shape(u), self.area)

    def _cut(self, origins: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns distances in units of the direction, infinite for parallel rays, and (u, v) in the plane."""
        towards = directions @ self.normal
        parallel = np.abs(towards) < PARALLEL
        height = (self.corner - origins) @ self.normal
        distance = np.where(parallel, np.inf, height / np.where(parallel, 1.0, towards))
        reach = np.where(np.isfinite(distance), distance, 0.0)
        place = origins + reach[:, None] * directions - self.corner
        uu, uv, vv = self.edge_u @ self.edge_u, self.edge_u @ self.edge_v, self.edge_v @ self.edge_v
        dual_u, dual_v = vv * self.edge_u - uv * self.edge_v, uu * self.edge_v - uv * self.edge_u
        determinant = uu * vv - uv * uv
        return distance, place @ dual_u / determinant, place @ dual_v / determinant
