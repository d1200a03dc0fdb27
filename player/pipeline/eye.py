"""What belongs to one camera of a room on a device: its maps, what a frame asks of it, and what it would see.

A usual room has one eye. A set of views has one a view (counterlight.viewpoints), of which a few have a share in a
drive at a time (company.py).
"""

from functools import cached_property, partial
from typing import NamedTuple

from counterlight.pipeline.device import ChainPass, Device, Light, Operation, Owner, StoredMaps
from counterlight.pipeline.map_views import MapViews, Observer
from counterlight.pipeline.mixer import Mixer
from counterlight.pipeline.refiner import Refiner
from counterlight.pipeline.request import Request
from counterlight.pipeline.room import Room


class Eye:
    """refiner : None without the maps of refinement.  request, views : what is asked for, and maps that are shown."""

    def __init__(self, device: Device, room: Room, path: str) -> None:
        self.room, self._owner = room, Owner()
        self._guesses: dict[tuple[str, bool], Guess] = {}
        try:
            self._build(device, path)
        except BaseException:
            self.release()
            raise

    def _build(self, device: Device, path: str) -> None:
        own, maps = self._owner.own, self.room.maps
        ambient = own(device.picture(self.room.ambient))
        self.stored = own(device.store(self.room, path))
        undo = None if maps.undo is None else own(ChainPass(self.stored, maps.undo, "SUBTRACT_FROM_BASE"))
        self.near_light = NearLight(undo)
        self.refiner = None
        if maps.refinement is not None:
            self.refiner = own(Refiner(device, self.stored, maps.refinement))
        mixer = own(Mixer(device, self.room))
        self._make_observer = partial(Observer, self.stored, ambient, mixer)
        self.views = own(MapViews(device, self.stored, ambient, mixer))
        self.request = own(Request(device, self.room, ambient, self.views, self.near_light, mixer))

    @cached_property
    def observers(self) -> list[Observer]:
        """Of the drive that is shown, and of another one beside it; made with the first view of the camera's."""
        return [self._owner.own(self._make_observer()) for _ in range(2)]

    def guess(self, of: str, *, clamp: bool) -> "Guess":
        """b -> a drive without steps, made when first asked for.

        of : "map", T⁺ b of the near light, or "direct", the camera pixel that each projector pixel lights most.
        """
        if (of, clamp) not in self._guesses:
            self._guesses[of, clamp] = self._owner.own(Guess(self.stored, self.near_light, of, "CLAMP" * clamp))
        return self._guesses[of, clamp]

    def release(self) -> None:
        self._owner.release()


class Asked(NamedTuple):
    """What one eye asks of a drive: b of the frame, and how much that counts, all shares of sum 1."""

    share: float
    eye: Eye
    b: Light


class NearLight:
    """b -> b without the far light of the compensated picture."""

    def __init__(self, undo: ChainPass | None) -> None:
        self._undo = undo

    def __call__(self, b: Light) -> Light:
        return b if self._undo is None else self._undo.run(b, b)


class Guess:
    """b -> a drive by one product; built when first called, for steps may start without.

    combine : "", or "CLAMP" to limit it to 0..1.
    """

    def __init__(self, stored: StoredMaps, near_light: NearLight, of: str, combine: str = "") -> None:
        self._stored, self._near_light, self._of, self._combine = stored, near_light, of, combine
        self._product: Operation | None = None

    def __call__(self, b: Light) -> Light:
        maps = self._stored.room.maps
        if self._product is None:
            assert self._of == "map" or maps.refinement is not None
            packed = maps.correction if self._of == "map" or maps.refinement is None else maps.refinement.direct
            self._product = self._stored.of(packed).product(self._combine)
        return self._product.run(self._near_light(b) if self._of == "map" else b)

    def release(self) -> None:
        if self._product is not None:
            self._product.release()
