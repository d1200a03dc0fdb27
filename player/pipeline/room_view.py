"""One view of a room on a device: its maps, its targets, and its prediction of the camera picture.

A usual room has one view. A set of views has several (counterlight.viewpoints); only some have a share in a drive at a
time (view_blend.py).
"""

from functools import cached_property, partial
from typing import Generic, NamedTuple

from counterlight.passes.drawing import Picture
from counterlight.passes.product import Combining
from counterlight.pipeline.correction import AmbientLight, RowGains
from counterlight.pipeline.device import ChainPass, Device, Owner, Owning, Product, StoredMaps
from counterlight.pipeline.map_views import MapViews, Observer
from counterlight.pipeline.mixer import Mixer
from counterlight.pipeline.refiner import Refiner
from counterlight.pipeline.request import Request
from counterlight.pipeline.room import Room


class RoomView(Owning, Generic[Picture]):
    """The maps and passes of one view.

    refiner : None without the maps of refinement.
    ambient : the ambient light.
    row_gains : changes of the room's light.
    request : computes the targets.
    views : draws the maps that can be shown.
    """

    def __init__(self, device: Device[Picture], room: Room) -> None:
        self.room, self._owner = room, Owner()
        self._guesses: dict[tuple[str, bool], Guess[Picture]] = {}
        with self._owner:
            self._build(device)

    def _build(self, device: Device[Picture]) -> None:
        own, maps = self._owner.own, self.room.maps
        self.ambient = own(AmbientLight(device, self.room))
        self.row_gains = own(RowGains(device, self.room))
        ambient = self.ambient.picture
        self.stored = own(device.store(self.room))
        undo = None if maps.undo is None else own(ChainPass(self.stored, maps.undo, "SUBTRACT_FROM_BASE"))
        self.near_light = NearLight(undo)
        self.refiner: Refiner[Picture] | None = None
        if maps.refinement is not None:
            self.refiner = own(Refiner(device, self.stored, maps.refinement))
        mixer = own(Mixer(device, self.room))
        self._make_observer = partial(Observer, self.stored, ambient, mixer, self.row_gains)
        self.views = own(MapViews(device, self.stored, ambient, mixer))
        self.request = own(Request(device, self.room, ambient, self.row_gains, self.views, self.near_light, mixer))

    @cached_property
    def observers(self) -> list[Observer[Picture]]:
        """Two observers, for the shown drive and for a second drive, made when a camera view is first shown."""
        return [self._owner.own(self._make_observer()) for _ in range(2)]

    def guess(self, of: str, *, clamp: bool) -> "Guess[Picture]":
        """Return a function from b to a drive without steps, made on first use.

        of : "map" for T⁺ b of the near light; "direct" for the camera pixel that each projector pixel lights most.
        clamp : whether the drive is limited to 0..1.
        """
        if (of, clamp) not in self._guesses:
            self._guesses[of, clamp] = self._owner.own(
                Guess(self.stored, self.near_light, of, "CLAMP" if clamp else "")
            )
        return self._guesses[of, clamp]


class Target(NamedTuple, Generic[Picture]):
    """The target b of one view for a frame, and the view's share in the drive. All shares sum to 1."""

    share: float
    view: RoomView[Picture]
    b: Picture


class NearLight(Generic[Picture]):
    """Removes the far light of the compensated picture from b."""

    def __init__(self, undo: ChainPass[Picture] | None) -> None:
        self._undo = undo

    def __call__(self, b: Picture) -> Picture:
        return b if self._undo is None else self._undo.run(b, b)


class Guess(Generic[Picture]):
    """Maps b to a drive by one product. The product is built on the first call, because steps may start without it.

    combine : "", or "CLAMP" to limit the drive to 0..1.
    """

    def __init__(
        self, stored: StoredMaps[Picture], near_light: NearLight[Picture], of: str, combine: Combining = ""
    ) -> None:
        self._stored, self._near_light, self._of, self._combine = stored, near_light, of, combine
        self._product: Product[Picture] | None = None

    def __call__(self, b: Picture) -> Picture:
        maps = self._stored.room.maps
        if self._product is None:
            assert self._of == "map" or maps.refinement is not None
            packed = maps.correction if self._of == "map" or maps.refinement is None else maps.refinement.direct
            self._product = self._stored.of(packed).product(self._combine)
        return self._product.run(self._near_light(b) if self._of == "map" else b)

    def release(self) -> None:
        if self._product is not None:
            self._product.release()
