"""The mixing of a room's primaries on its device; see counterlight.maps.mixing."""

from functools import cached_property
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.drawing import Canvas, Picture, Rows
from counterlight.passes.mixing import Mix
from counterlight.pipeline.device import Device, Owner, Owning
from counterlight.pipeline.room import Room


class Mixer(Owning, Generic[Picture]):
    """Mixing matrices of every camera pixel as pictures, each made on first use; none if channels do not mix.

    squares : (9,). Q Qᵀ for passes that take `rows` and limit the light.
    """

    def __init__(self, device: Device[Picture], room: Room) -> None:
        self._device, self._owner = device, Owner()
        self._mixing, self._camera = room.mixing, room.calibration.camera.shape
        self.mixes = self._mixing.pixel is not None
        self.squares = self._mixing.squares.ravel().astype(np.float32) if self.mixes else None

    @cached_property
    def rows(self) -> Rows[Picture] | None:
        """The matrices A."""
        return self._pictures(self._mixing.inverse)

    def unmixed(self, light: Picture) -> Picture:
        """Return A light; valid until the next call."""
        return light if self.rows is None else self._unmixed.draw(Mix(light, self.black, self.rows))

    @cached_property
    def seen_rows(self) -> Rows[Picture] | None:
        """The matrices B."""
        return self._pictures(self._mixing.pixel)

    def on_screen(self, light: Picture) -> Picture:
        """Return B light, light of the transport in screen primaries; valid until the next call."""
        return light if self.seen_rows is None else self._on_screen.draw(Mix(light, self.black, self.seen_rows))

    def canvas(self) -> Canvas[Picture]:
        """Return a new canvas of the camera's size; the caller releases it."""
        return self._device.canvas(self._camera)

    def _pictures(self, matrices: NDArray[np.float32] | None) -> Rows[Picture] | None:
        if matrices is None:
            return None
        rows = (np.ascontiguousarray(matrices[..., row, :]) for row in range(3))
        return Rows(*(self._owner.own(self._device.picture(each)) for each in rows))

    @cached_property
    def black(self) -> Picture:
        """A black picture of the camera's size."""
        return self._owner.own(self._device.picture(np.zeros((*self._camera, 3), np.float32)))

    @cached_property
    def _unmixed(self) -> Canvas[Picture]:
        return self._owner.own(self.canvas())

    @cached_property
    def _on_screen(self) -> Canvas[Picture]:
        return self._owner.own(self.canvas())
