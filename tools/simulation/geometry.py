"""Ray tracing over all surfaces of a scene: the end of a ray, and whether a surface blocks a segment."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.simulation.paths import Batch
from counterlight.tools.simulation.surfaces import Surface


@dataclass(frozen=True)
class Hits(Batch):
    """Ends of rays; every array is (rays,) unless stated.

    surface : index, −1 for no hit; the other fields then have no meaning.
    distance : distance in units of the ray's direction.
    u, v, facet : place on the surface.
    point, normal : (rays, 3). The unit normal is turned towards the ray.
    front : whether the ray meets the side that the shape's own normal points to.
    """

    surface: IntArray
    distance: FloatArray
    u: FloatArray
    v: FloatArray
    facet: IntArray
    point: FloatArray
    normal: FloatArray
    front: NDArray[np.bool_]


def trace(origins: FloatArray, directions: FloatArray, surfaces: Sequence[Surface]) -> Hits:
    """Returns the nearest surface along each ray.

    origins : (3,) or (rays, 3).
    directions : (rays, 3), of any length.
    """
    count = len(directions)
    origins = np.broadcast_to(origins, directions.shape)
    distance = np.full(count, np.inf)
    surface, facet = np.full(count, -1), np.full(count, -1)
    u, v, normal = np.zeros(count), np.zeros(count), np.zeros((count, 3))
    for index, candidate in enumerate(surfaces):
        met = candidate.shape.meet(origins, directions)
        near = met.distance < distance[met.ray]
        ray = met.ray[near]
        distance[ray], surface[ray], facet[ray] = met.distance[near], index, met.facet[near]
        u[ray], v[ray], normal[ray] = met.u[near], met.v[near], met.normal[near]
    point = origins + np.where(surface >= 0, distance, 0.0)[:, None] * directions
    front = np.sum(normal * directions, axis=1) <= 0
    return Hits(surface, distance, u, v, facet, point, np.where(front[:, None], normal, -normal), front)


def blocked(starts: FloatArray, ends: FloatArray, surfaces: Sequence[Surface]) -> NDArray[np.bool_]:
    """Returns the mask of segments that a surface cuts strictly between their ends; clear surfaces block too.

    starts : (n, 3).
    ends : (n, 3) or (3,).
    """
    directions = ends - starts
    result = np.zeros(len(directions), bool)
    for surface in surfaces:
        result |= surface.shape.blocks(starts, directions)
    return result
