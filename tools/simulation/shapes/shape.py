"""The common interface of shapes: where rays meet a shape, whether it blocks them, and its own points by (u, v)."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray

TOO_CLOSE = 1e-6  # fraction of a direction's length: a ray does not meet the surface that it starts on


@dataclass(frozen=True)
class Meeting:
    """The nearest points where rays meet a shape, one row per ray that meets it.

    ray : index of the ray.
    distance : distance in units of the ray's direction.
    u, v : place on the shape.
    normal : (rays, 3). Outward unit normal.
    facet : triangle, or −1 for shapes without triangles.
    """

    ray: IntArray
    distance: FloatArray
    u: FloatArray
    v: FloatArray
    normal: FloatArray
    facet: IntArray


class Shape(Protocol):
    """A piece of a surface, parametrised by (u, v).

    flat : whether it is a parallelogram.
    closed : whether it bounds a solid; normals then point outwards.
    convex : whether no part of it can shade or light another part.
    v_range : range of v; u runs from 0 to 1.
    wraps : whether u = 0 and u = 1 are the same place.
    """

    @property
    def flat(self) -> bool: ...

    @property
    def closed(self) -> bool: ...

    @property
    def convex(self) -> bool: ...

    @property
    def v_range(self) -> tuple[float, float]: ...

    @property
    def wraps(self) -> bool: ...

    def meet(self, origins: FloatArray, directions: FloatArray) -> Meeting:
        """Returns the nearest meeting of each ray.

        origins : (3,) or (n, 3).
        directions : (n, 3), of any length.
        """

    def blocks(self, starts: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        """Returns the mask of the segments from starts to starts + directions that the shape cuts strictly inside."""

    def at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Returns points (…, 3) at u, v (…)."""

    def normals(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Returns unit normals (…, 3) at u, v (…)."""

    def density(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Returns area per du dv (…) at u, v (…)."""


def shape_area(shape: Shape, side: int = 64) -> float:
    """Returns the area in square metres, by the midpoint rule."""
    low, high = shape.v_range
    middle = (np.arange(side) + 0.5) / side
    u, v = np.meshgrid(middle, low + (high - low) * middle)
    return float(shape.density(u, v).mean() * (high - low))


def sample_places(shape: Shape, side: int) -> tuple[FloatArray, FloatArray]:
    """Returns u, v of side × side places, spread over a shape from edge to edge, (side²,) each."""
    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(*shape.v_range, side))
    return u.ravel(), v.ravel()
