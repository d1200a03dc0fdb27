"""Where rays end, and whether anything stands between two points: over all surfaces of a scene."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.simulation.batch import Batch
from counterlight.tools.simulation.surfaces import Surface


@dataclass(frozen=True)
class Hits(Batch):
    """Where rays end, (rays,) each: surface (−1 for none; the rest is then without meaning), place and facet on it.

    distance : in units of the ray's direction.  point, normal : (rays, 3); the unit normal is turned towards the ray.
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
    """The nearest surface along each ray; origins (3,) or (rays, 3), directions (rays, 3) of any length."""
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
    """Which segments (n, 3) -> (n, 3) or (3,) are cut by a surface strictly between their ends, a clear one, too."""
    directions = ends - starts
    result = np.zeros(len(directions), bool)
    for surface in surfaces:
        result |= surface.shape.blocks(starts, directions)
    return result
