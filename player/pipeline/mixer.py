"""The mixing of a room's primaries on its device; see counterlight.maps.mixing."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from counterlight.pipeline.device import Device, Light, Owner, Pass
from counterlight.pipeline.room import Room

ROWS = "row_red", "row_green", "row_blue"


class Mixer:
    """Mixing matrices of every camera pixel as pictures, each made on first use; none if channels do not mix.

    defines : shader defines for passes that take `rows`.
    uniforms : shader uniforms for passes that take `rows` and limit the light.
    """

    def __init__(self, device: Device, room: Room) -> None:
        self._device, self._owner = device, Owner()
        self._mixing, self._camera = room.mixing, room.calibration.camera.shape
        self.mixes = self._mixing.pixel is not None
        self.defines: dict[str, int | None] = {"MIXED": None} if self.mixes else {}
        squares = self._mixing.squares.ravel().astype(np.float32)
        self.uniforms: dict[str, NDArray[np.float32]] = {"squares": squares} if self.mixes else {}

    @cached_property
    def rows(self) -> dict[str, Light]:
        """The matrices A as shader inputs."""
        return self._pictures(self._mixing.inverse)

    def asked(self, light: Light) -> Light:
        """Return A light; valid until the next call."""
        return self._asked.run(light=light, base=self.black, **self.rows) if self.mixes else light

    def seen(self) -> Pass:
        """Return a new pass for B light + base: run(light, base, **seen_rows). The caller releases it."""
        return self._device.make_pass("mix.frag", self._camera)

    @cached_property
    def seen_rows(self) -> dict[str, Light]:
        """The matrices B as inputs of a `seen` pass."""
        return self._pictures(self._mixing.pixel)

    def on_screen(self, light: Light) -> Light:
        """Return B light, light of the transport in screen primaries; valid until the next call."""
        return self._on_screen.run(light=light, base=self.black, **self.seen_rows) if self.mixes else light

    def recolour(self, shape: tuple[int, int]) -> Pass | None:
        """Return a pass from camera radiance to screen primaries, or None if both are equal; the caller releases it."""
        if self._mixing.neutral is None:
            return None
        matrix = self._mixing.to_screen.T.ravel().astype(np.float32)  # column by column, as OpenGL expects
        return self._device.make_pass("recolour.frag", shape, matrix=matrix)

    def release(self) -> None:
        self._owner.release()

    def _pictures(self, matrices: NDArray[np.float32] | None) -> dict[str, Light]:
        if matrices is None:
            return {}
        return {
            name: self._owner.own(self._device.picture(np.ascontiguousarray(matrices[..., row, :])))
            for row, name in enumerate(ROWS)
        }

    @cached_property
    def black(self) -> Light:
        """A black picture of the camera's size."""
        return self._owner.own(self._device.picture(np.zeros((*self._camera, 3), np.float32)))

    @cached_property
    def _asked(self) -> Pass:
        return self._owner.own(self.seen())

    @cached_property
    def _on_screen(self) -> Pass:
        return self._owner.own(self.seen())
