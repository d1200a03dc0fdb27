"""Straight rays: devices that see or project through one point, and the rectangles that rays meet."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

CLOSE = 1e-6  # fraction of a segment near its ends, which lie on surfaces


@dataclass(frozen=True)
class Pinhole:
    """A camera's or a projector's geometry; x to the right, y down, z away from the first camera, metres.

    Pixel coordinates (u, v) run from 0 to width and height; pixel j covers j to j + 1.

    axes : (3, 3). Rows right, down, forward.
    focal : pixels.
    size : (height, width).
    """

    position: FloatArray
    axes: FloatArray
    focal: float
    size: tuple[int, int]

    def directions(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Returns unit vectors through pixel coordinates: (…, 3)."""
        height, width = self.size
        local = np.stack([(u - width / 2) / self.focal, (v - height / 2) / self.focal, np.ones_like(u)], axis=-1)
        local /= np.linalg.norm(local, axis=-1, keepdims=True)
        return np.asarray(local @ self.axes)

    def local(self, points: FloatArray) -> FloatArray:
        """Returns points as right, down and forward of the device: (…, 3), metres."""
        return np.asarray((points - self.position) @ self.axes.T)

    def pixels(self, local: FloatArray) -> FloatArray:
        """Returns (u, v) of local points: (…, 2)."""
        height, width = self.size
        return np.asarray(local[..., :2] / local[..., 2:] * self.focal + (width / 2, height / 2))

    def solid_angle(self, uv: FloatArray) -> FloatArray:
        """Returns the solid angle of one pixel at `uv`, steradian: cos³θ / focal²."""
        height, width = self.size
        squared = np.sum((uv - (width / 2, height / 2)) ** 2, axis=-1) / self.focal**2
        return np.asarray((1 + squared) ** -1.5 / self.focal**2)


def looking(position: Sequence[float], target: Sequence[float], focal: float, size: tuple[int, int]) -> Pinhole:
    """Returns an upright device at `position` whose axis passes through `target`."""
    start = np.asarray(position, np.float64)
    forward = _unit(np.asarray(target) - start)
    right = _unit(np.cross([0.0, 1.0, 0.0], forward))
    return Pinhole(start, np.stack([right, np.cross(forward, right), forward]), focal, size)


@dataclass(frozen=True)
class Rectangle:
    """Points corner + a·across + b·down, a and b from 0 to 1; the sides are orthogonal, the normal is across × down."""

    corner: FloatArray
    across: FloatArray
    down: FloatArray

    @property
    def normal(self) -> FloatArray:
        return _unit(np.cross(self.across, self.down))

    def point(self, shares: FloatArray) -> FloatArray:
        """Returns points (…, 3) from shares (…, 2) of the sides."""
        return np.asarray(self.corner + shares[..., :1] * self.across + shares[..., 1:] * self.down)

    def shares(self, points: FloatArray) -> FloatArray:
        """Returns shares (…, 2) of the sides from points (…, 3) in the plane."""
        sides = np.stack([self.across / (self.across @ self.across), self.down / (self.down @ self.down)])
        return np.asarray((points - self.corner) @ sides.T)

    def distance(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Returns distances along rays to the plane, (n,); infinite for a plane behind or parallel."""
        against = directions @ self.normal
        along = (self.corner - origins) @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            t = along / against
        return np.where((t > 0) & (np.abs(against) > 1e-12), t, np.inf)

    def meet(self, origins: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns the distance (infinite for a miss) and the shares of the sides there."""
        t = self.distance(origins, directions)
        reached = np.where(np.isfinite(t), t, 0)
        shares = self.shares(origins + reached[:, None] * directions)
        inside = np.all((shares >= 0) & (shares <= 1), axis=1)
        return np.where(inside, t, np.inf), shares

    def blocks(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Returns whether the rectangle stands between two points: (n,)."""
        t, _ = self.meet(np.broadcast_to(starts, ends.shape), ends - starts)
        return np.asarray((t > CLOSE) & (t < 1 - CLOSE))


def nearest(
    rectangles: Sequence[Rectangle], origins: FloatArray, directions: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """Returns the rectangle that each ray meets first (−1: none), and the shares of its sides there."""
    found, reach, where = np.full(len(origins), -1), np.full(len(origins), np.inf), np.zeros((len(origins), 2))
    for index, rectangle in enumerate(rectangles):
        t, shares = rectangle.meet(origins, directions)
        closer = t < reach
        found[closer], reach[closer], where[closer] = index, t[closer], shares[closer]
    return found, where


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))
