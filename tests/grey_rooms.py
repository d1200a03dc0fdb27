"""Rooms with the same T in every channel."""

from typing import NamedTuple

import numpy as np
from scipy import sparse

import counterlight as cl
from counterlight.tools.transport.transport import channel, in_one


class GreyRoom(NamedTuple):
    """Room without colour.

    T : (camera pixels, projector pixels), for each channel.
    camera, projector : (height, width).
    ambient : radiance.
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
    """Green channel of a shipped room, with near and far light in one matrix."""
    room = cl.simulate(name, camera=camera, projector=projector)
    T = channel(in_one(room.parts), 1).astype(np.float64)
    return GreyRoom(name, T, room.camera, room.projector, float(np.median(room.ambient[..., 1])))
