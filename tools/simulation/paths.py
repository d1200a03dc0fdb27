"""Data along the light paths of a scene: arrays of equal length that are cut together."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray


class Batch:
    """A dataclass of arrays with one row per ray, point or beam; text fields hold for the whole batch."""

    def at(self, index: NDArray[np.bool_] | IntArray | slice) -> Self:
        """Returns some of the rows."""
        columns = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        return type(self)(**{k: v if isinstance(v, str) else v[index] for k, v in columns.items()})


B = TypeVar("B", bound=Batch)


def joined(parts: Sequence[B]) -> B:
    """Returns one batch with the rows of all batches; text fields come from the first batch."""
    names = [field.name for field in fields(parts[0])]  # type: ignore[arg-type]
    columns = {name: [getattr(part, name) for part in parts] for name in names}
    return type(parts[0])(**{k: v[0] if isinstance(v[0], str) else np.concatenate(v) for k, v in columns.items()})


@dataclass(frozen=True)
class Rays(Batch):
    """Rays that run backwards, from the camera into the room.

    pixel : (n,). Camera pixel.
    origin, direction : (n, 3). Directions have length 1.
    throughput : (n, 3). Radiance in the camera pixel per radiance that arrives along the ray.
    inside : (n,). Index of the dielectric surface around the ray; −1 for air.
    effect : name of the effect that made the rays.
    """

    pixel: IntArray
    origin: FloatArray
    direction: FloatArray
    throughput: FloatArray
    inside: IntArray
    effect: str


@dataclass(frozen=True)
class Samples(Batch):
    """Points of matt surfaces that a camera pixel sees, and their throughput.

    pixel, surface, u, v, facet : (n,), see Hits.
    point, normal : (n, 3).
    front : (n,). Whether the surface's own side is seen.
    towards : (n, 3). Unit directions in which the light leaves.
    throughput : (n, 3). Radiance in the camera pixel per radiance that leaves the point in that direction.
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

    sample : (n,). Index into the batch of samples.
    pixel : (n,). Projector pixel.
    irradiance : (n, 3), or (n, 1) for equal channels. At the sample, per unit drive of that pixel.
    origin : (n, 3). Point of the projector's lens where the last segment starts; NaN for light from many directions.
    """

    sample: IntArray
    pixel: IntArray
    irradiance: FloatArray
    origin: FloatArray
    effect: str


@dataclass(frozen=True)
class Deposits(Batch):
    """Projector light traced forwards until it ends on matt surfaces.

    pixel : (n,). Projector pixel.
    surface, u, v, facet, front, point, normal : where it ends, see Hits.
    flux : (n, 3) or (n, 1). Power per unit drive.
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
