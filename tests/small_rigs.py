"""Rooms of the rig for tests, with a fifth of the pixels along each side."""

from functools import cache

from tests.rig.rig import Devices, Rig
from tests.rig.rooms import ROOMS, Room

SCALE = 0.2


@cache
def small_room(name: str) -> Room:
    return ROOMS[name](SCALE)


@cache
def small_rig(name: str, light: str = "led") -> Rig:
    return Rig(small_room(name), Devices(light=light))
