"""Rooms of which every channel has the same T."""

from typing import NamedTuple

import numpy as np
from scipy import sparse

import counterlight as cl
from counterlight.tools.transport.transport import channel, in_one


class GreyRoom(NamedTuple):
    """A room without colour.

    T : of each channel, (camera pixels, projector pixels).  camera, projector : (height, width).  ambient : radiance.
    """

    name: str
    T: sparse.csr_array
    camera: tuple[int, int]
    projector: tuple[int, int]
    ambient: float

    @property
    def in_product(self) -> cl.Room:
        sizes = {"camera": self.camera, "projector": self.projector}
        return cl.Room.from_matrices(self.T, self.T, self.T, **sizes, ambient=self.ambient, response="linear")


def shipped_in_green(name: str, camera: tuple[int, int], projector: tuple[int, int]) -> GreyRoom:
    """The green channel of a shipped room, with all its light in one matrix."""
    room = cl.simulate(name, camera=camera, projector=projector)
    T = channel(in_one(room.transport), 1).astype(np.float64)
    return GreyRoom(name, T, room.camera, room.projector, float(np.median(room.ambient[..., 1])))
