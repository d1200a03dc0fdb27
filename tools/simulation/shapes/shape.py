"""What every shape offers: where rays meet it, whether it stands in their way, and its own points by (u, v)."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
TOO_CLOSE = 1e-6  # of a direction's length: a ray does not meet the surface that it starts on


@dataclass(frozen=True)
class Meeting:
    """The nearest point where some rays meet a shape, one row for each ray that does.

    ray : index of the ray.  distance : in units of its direction.  u, v : the place on the shape.
    normal : outward unit normal (rays, 3).  facet : triangle, or −1 for shapes without.
    """

    ray: IntArray
    distance: FloatArray
    u: FloatArray
    v: FloatArray
    normal: FloatArray
    facet: IntArray


class Shape(Protocol):
    """A piece of a surface, parametrised by (u, v).

    flat : it is a parallelogram.  closed : it bounds a solid, normals point out of it.
    convex : no part of it can shade or light another.
    v_range : what v runs through; u runs from 0 to 1.  wraps : u = 0 and u = 1 are the same place.
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
        """The nearest meeting of each ray; origins (n, 3), directions (n, 3) of any length."""

    def blocks(self, starts: FloatArray, directions: FloatArray) -> NDArray[np.bool_]:
        """Which segments from starts to starts + directions it cuts strictly between their ends."""

    def at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Points (…, 3) at u, v (…)."""

    def normals(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Unit normals (…, 3) at u, v (…)."""

    def density(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Area per du dv (…) at u, v (…)."""


def shape_area(shape: Shape, side: int = 64) -> float:
    """Square metres, by the midpoint rule."""
    low, high = shape.v_range
    middle = (np.arange(side) + 0.5) / side
    u, v = np.meshgrid(middle, low + (high - low) * middle)
    return float(shape.density(u, v).mean() * (high - low))


def sample_places(shape: Shape, side: int) -> tuple[FloatArray, FloatArray]:
    """u, v of side × side places spread over a shape from edge to edge, (side²,) each."""
    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(*shape.v_range, side))
    return u.ravel(), v.ravel()
