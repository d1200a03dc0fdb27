"""Spheres and cylinders in closed form: the roots of a quadratic along the ray."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.shapes.shape import TOO_CLOSE, Meeting

CAP = 1.0  # a cylinder's caps use v from −1 to 0 and from 1 to 2


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere. u runs around the vertical axis, v by height from bottom (0) to top (1); v is proportional to area."""

    centre: FloatArray
    radius: float
    flat = False
    closed = True
    convex = True
    v_range = (0.0, 1.0)
    wraps = True

    def meet(self, origins: FloatArray, directions: FloatArray) -> Meeting:
        near, far = self._roots(origins, directions)
        distance = np.where(near > TOO_CLOSE, near, far)
        ray = np.flatnonzero((distance > TOO_CLOSE) & np.isfinite(distance))
        start = origins[ray] if origins.ndim == 2 else origins
        normal = (start + distance[ray, None] * directions[ray] - self.centre) / self.radius
        u = np.arctan2(normal[:, 2], normal[:, 0]) / (2 * np.pi) % 1.0
        v = np.clip((normal[:, 1] + 1) / 2, 0.0, 1.0)
        return Meeting(ray, distance[ray], u, v, normal, np.full(ray.size, -1))

    def blocks(self, starts: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        return _any_between(self._roots(starts, directions))

    def at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        return self.centre + self.radius * self.normals(u, v)

    def normals(self, u: FloatArray, v: FloatArray) -> FloatArray:
        height = 2 * np.asarray(v) - 1
        ring, angle = np.sqrt(np.maximum(1 - height**2, 0)), 2 * np.pi * np.asarray(u)
        return np.stack([ring * np.cos(angle), height, ring * np.sin(angle)], axis=-1)

    def density(self, u: FloatArray, v: FloatArray) -> FloatArray:
        return np.full(np.shape(u), 4 * np.pi * self.radius**2)  # Archimedes

    def _roots(self, origins: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        offset = origins - self.centre
        return _quadratic(
            np.sum(directions**2, axis=-1),
            np.sum(offset * directions, axis=-1),
            np.sum(offset**2, axis=-1) - self.radius**2,
        )


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A round solid from `base` along `axis`.

    u runs around. v runs from 0 (base) to 1 (top) on the side, from −1 to 0 on the base's cap from its centre outwards,
    and from 1 to 2 on the top's cap inwards.

    across, deep : unit vectors; with the axis they form a right-handed frame.
    """

    base: FloatArray
    axis: FloatArray
    radius: float
    across: FloatArray
    deep: FloatArray
    flat = False
    closed = True
    convex = True
    v_range = (-CAP, 1 + CAP)
    wraps = True

    def meet(self, origins: FloatArray, directions: FloatArray) -> Meeting:
        origins = np.broadcast_to(origins, directions.shape)
        crossings = self._crossings(origins, directions)
        usable = np.where(crossings > TOO_CLOSE, crossings, np.inf)
        which = np.argmin(usable, axis=1)
        distance = usable[np.arange(len(usable)), which]
        ray = np.flatnonzero(np.isfinite(distance))
        place = origins[ray] + distance[ray, None] * directions[ray] - self.base
        x, y = place @ self.across / self.radius, place @ self.deep / self.radius
        u, ring = np.arctan2(y, x) / (2 * np.pi) % 1.0, np.minimum(np.hypot(x, y), 1.0)
        along = np.clip(place @ self.axis / (self.axis @ self.axis), 0.0, 1.0)
        v = np.choose(which[ray] // 2 + (which[ray] == 3), [along, ring - 1, 2 - ring])
        return Meeting(ray, distance[ray], u, v, self.normals(u, v), np.full(ray.size, -1))

    def blocks(self, starts: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        crossings = self._crossings(np.broadcast_to(starts, directions.shape), directions)
        return _any_between(tuple(crossings.T))

    def at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        v = np.asarray(v)
        ring = self.radius * np.where(v < 0, 1 + v, np.where(v > 1, 2 - v, 1.0))
        return np.asarray(
            self.base + np.clip(v, 0, 1)[..., None] * self.axis + ring[..., None] * self._outwards(np.asarray(u))
        )

    def normals(self, u: FloatArray, v: FloatArray) -> FloatArray:
        v = np.asarray(v)[..., None]
        up = self.axis / np.linalg.norm(self.axis)
        return np.asarray(np.where(v < 0, -up, np.where(v > 1, up, self._outwards(np.asarray(u)))))

    def density(self, u: FloatArray, v: FloatArray) -> FloatArray:
        v = np.asarray(v)
        ring = np.where(v < 0, 1 + v, 2 - v)
        side = 2 * np.pi * self.radius * float(np.linalg.norm(self.axis))
        return np.where((v < 0) | (v > 1), 2 * np.pi * self.radius**2 * ring, side)

    def _outwards(self, u: FloatArray) -> FloatArray:
        angle = 2 * np.pi * u[..., None]
        return np.asarray(np.cos(angle) * self.across + np.sin(angle) * self.deep)

    def _crossings(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Returns distances (n, 4): two for the side, one each for base and top; infinite for no crossing."""
        height = float(np.linalg.norm(self.axis))
        up = self.axis / height
        offset = origins - self.base
        flat_offset, flat_direction = offset - (offset @ up)[:, None] * up, directions - (directions @ up)[:, None] * up
        roots = _quadratic(
            np.sum(flat_direction**2, axis=1),
            np.sum(flat_offset * flat_direction, axis=1),
            np.sum(flat_offset**2, axis=1) - self.radius**2,
        )
        result = []
        level, climb = offset @ up, directions @ up
        for root in roots:
            along = level + np.where(np.isfinite(root), root, 0.0) * climb
            result.append(np.where((along >= 0) & (along <= height), root, np.inf))
        steady = np.abs(climb) < 1e-300
        for target in (0.0, height):
            distance = np.where(steady, np.inf, (target - level) / np.where(steady, 1.0, climb))
            reach = np.where(steady, 0.0, distance)
            away = np.sum((flat_offset + reach[:, None] * flat_direction) ** 2, axis=1)
            result.append(np.where(away < self.radius**2, distance, np.inf))
        return np.stack(result, axis=1)


def _quadratic(a: FloatArray, half_b: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns the roots of a t² + 2 half_b t + c = 0, the smaller first; infinite if there are none.

    The root of larger magnitude is computed without cancellation, the other root from their product c / a.
    """
    discriminant = half_b**2 - a * c
    real = (discriminant >= 0) & (a > 1e-300)
    q = -(half_b + np.copysign(np.sqrt(np.where(real, discriminant, 0.0)), half_b))
    first = np.where(real, q / np.where(real, a, 1.0), np.inf)
    second = np.where(real & (q != 0), c / np.where(q != 0, q, 1.0), first)
    return np.minimum(first, second), np.maximum(first, second)


def _any_between(crossings: tuple[FloatArray, ...]) -> NDArray[np.bool_]:
    return np.asarray(np.any([(t > TOO_CLOSE) & (t < 1 - TOO_CLOSE) for t in crossings], axis=0))
