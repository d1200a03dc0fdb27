"""What travels along the light paths of a scene: rays and samples on the camera's side, arrivals on the projector's."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.simulation.batch import Batch


@dataclass(frozen=True)
class Rays(Batch):
    """Rays that run backwards, from the camera into the room.

    pixel : camera pixel (n,).  origin, direction : (n, 3), directions of length 1.
    throughput : radiance in the camera pixel per radiance that comes along the ray, (n, 3).
    inside : index of the dielectric surface that the ray runs in, −1 for air, (n,).
    effect : what sent them on their way.
    """

    pixel: IntArray
    origin: FloatArray
    direction: FloatArray
    throughput: FloatArray
    inside: IntArray
    effect: str


@dataclass(frozen=True)
class Samples(Batch):
    """Points of matt surfaces that a camera pixel sees, and how much.

    pixel, surface, u, v, facet : (n,), see Hits.  point, normal : (n, 3).  front : the surface's own side, (n,).
    towards : unit directions to where the light leaves to, (n, 3).
    throughput : radiance in the camera pixel per radiance that leaves the point in that direction, (n, 3).
    """

    pixel: IntArray
    surface: IntArray
    u: FloatArray
    v: FloatArray
    facet: IntArray
    point: FloatArray
    normal: FloatArray
    front: NDArray[np.bool_]
    towards: FloatArray
    throughput: FloatArray
    effect: str


@dataclass(frozen=True)
class Arrivals(Batch):
    """Projector light that reaches samples.

    sample : index into the batch of samples (n,).  pixel : projector pixel (n,).
    irradiance : at the sample per unit drive of that pixel, (n, 3) or (n, 1) for all channels alike.
    origin : where its last leg starts, (n, 3), a point of the projector's lens; NaN for light from many directions.
    """

    sample: IntArray
    pixel: IntArray
    irradiance: FloatArray
    origin: FloatArray
    effect: str


@dataclass(frozen=True)
class Deposits(Batch):
    """Projector light traced forwards until it ends on matt surfaces.

    pixel : projector pixel (n,).  surface, u, v, facet, front, point, normal : where it ends, see Hits.
    flux : power per unit drive, (n, 3) or (n, 1).
    """

    pixel: IntArray
    surface: IntArray
    u: FloatArray
    v: FloatArray
    facet: IntArray
    front: NDArray[np.bool_]
    point: FloatArray
    normal: FloatArray
    flux: FloatArray
    effect: str
