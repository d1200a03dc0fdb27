"""The mixing of a room's primaries on its device; see counterlight.maps.mixing."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from counterlight.pipeline.device import Device, Light, Owner, Pass
from counterlight.pipeline.room import Room

ROWS = "row_red", "row_green", "row_blue"


class Mixer:
    """Matrices of every camera pixel as pictures, each made when first asked for; none where channels do not mix.

    defines, uniforms : what the shaders are told that ask by `rows`; uniforms where the light is limited.
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
        """A, as a shader's inputs."""
        return self._pictures(self._mixing.inverse)

    def asked(self, light: Light) -> Light:
        """A light, valid until the next call."""
        return self._asked.run(light=light, base=self.black, **self.rows) if self.mixes else light

    def seen(self) -> Pass:
        """A pass of its own for B light + base: run(light, base, **seen_rows); the caller releases it."""
        return self._device.make_pass("mix.frag", self._camera)

    @cached_property
    def seen_rows(self) -> dict[str, Light]:
        """B, as inputs of a `seen`."""
        return self._pictures(self._mixing.pixel)

    def on_screen(self, light: Light) -> Light:
        """B light, what light of the transport is in screen primaries, valid until the next call."""
        return self._on_screen.run(light=light, base=self.black, **self.seen_rows) if self.mixes else light

    def recolour(self, shape: tuple[int, int]) -> Pass | None:
        """A pass from camera radiance to screen primaries, None where they are the same; the caller releases it."""
        if self._mixing.neutral is None:
            return None
        matrix = self._mixing.to_screen.T.ravel().astype(np.float32)  # by columns, as OpenGL has them
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
        """No light, of the camera's size."""
        return self._owner.own(self._device.picture(np.zeros((*self._camera, 3), np.float32)))

    @cached_property
    def _asked(self) -> Pass:
        return self._owner.own(self.seen())

    @cached_property
    def _on_screen(self) -> Pass:
        return self._owner.own(self.seen())
