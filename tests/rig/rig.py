"""A rig: a projector in a room, the camera that calibrates, and the audience."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tests.rig.files import RAW, Stored
from tests.rig.lens import SHARP, Lens
from tests.rig.light import LIGHTS
from tests.rig.projector import Projector
from tests.rig.rays import FloatArray
from tests.rig.rooms import Room
from tests.rig.sensor import Sensor
from tests.rig.view import Shift, Transport, Truth, View

EXPOSED = 0.9  # share of full scale, for the brightest pixel of the floodlit room
PAPER = 0.9  # reflectance of the paper whose floodlit light is the unit of the room's light


@dataclass(frozen=True)
class Devices:
    """The devices in a room, in their present state.

    light : one of LIGHTS.
    stored : how the camera stores what its sensor saw.
    room_light : a share of a floodlit white's light.
    shift : shift of the projector's picture in projector pixels.
    camera_moved : in samples (quarters of a pixel), right and down.
    """

    light: str = "separate"
    projector: Projector = field(default_factory=Projector)
    lens: Lens = SHARP
    sensor: Sensor = field(default_factory=Sensor)
    stored: Stored = RAW
    room_light: float = 0.01
    shift: Shift = (0.0, 0.0)
    camera_moved: tuple[int, int] = (0, 0)


class Rig:
    """A room with devices. Radiance is relative to the calibrated camera's full scale.

    exposure : full scale of light; None sets it so that the floodlit room just fits. A changed rig keeps its exposure.
    """

    def __init__(self, room: Room, devices: Devices, exposure: float | None = None) -> None:
        self.room, self.devices = room, devices
        self.light = LIGHTS[devices.light]()
        self._truth = Truth(room, self.light, devices.shift, devices.lens)
        self.exposure = exposure if exposure is not None else self._set_exposure()

    def after(self, devices: Devices) -> "Rig":
        """Returns the same rig with changed devices."""
        return Rig(self.room, devices, self.exposure)

    @property
    def camera(self) -> tuple[int, int]:
        return self.room.lattice.camera

    @property
    def raster(self) -> tuple[int, int]:
        return self.room.raster

    @cached_property
    def calibrated(self) -> View:
        return View(self._truth, self.room.lattice.calibrated())

    @cached_property
    def audience(self) -> View:
        return View(self._truth, self.room.lattice.wide())

    @cached_property
    def transport(self) -> Transport:
        """T of the calibrated camera, relative to full scale."""
        return self.calibrated.transport().scaled(self.exposure)

    @cached_property
    def ambient(self) -> FloatArray:
        """The room's light as the calibrated camera sees it, without the projector: (camera pixels, 3)."""
        return self.calibrated.ambient() * self._ambient_scale

    def seen(self, codes: NDArray[np.uint8]) -> FloatArray:
        """Returns the calibrated camera's light without noise: (height, width, 3) codes -> (camera pixels, 3)."""
        return self.transport.apply(self.devices.projector.light(codes)) + self.ambient

    def seen_by_camera(self, codes: NDArray[np.uint8]) -> FloatArray:
        """Returns the camera's light without noise at its present place, (camera pixels, 3)."""
        T, ambient = self._present
        return T.apply(self.devices.projector.light(codes)) + ambient

    def seen_by_audience(self, codes: NDArray[np.uint8]) -> FloatArray:
        """Returns the audience's light, (audience pixels, 3)."""
        light = self.devices.projector.light(codes)
        return self.exposure * self.audience.rise(light) + self._ambient_scale * self.audience.ambient()

    def photograph(self, codes: NDArray[np.uint8], *seed: int) -> NDArray[np.uint16]:
        """Returns what the calibrated camera's sensor saw: (camera height, camera width, 3), 16 bits."""
        rng = np.random.default_rng(seed)
        seen = self.seen_by_camera(codes).reshape(*self.camera, 3)
        return self.devices.sensor.codes(seen, self.light.weakness, rng)

    @cached_property
    def _present(self) -> tuple[Transport, FloatArray]:
        """T and the room's light of the camera at its present place, as `transport` and `ambient`."""
        if self.devices.camera_moved == (0, 0):
            return self.transport, self.ambient
        view = View(self._truth, self.room.lattice.calibrated(self.devices.camera_moved))
        return view.transport().scaled(self.exposure), view.ambient() * self._ambient_scale

    @property
    def _ambient_scale(self) -> float:
        """The room's light relative to paper under the projector's floodlight."""
        return self.devices.room_light * self.exposure * self._bright / PAPER

    @cached_property
    def _bright(self) -> float:
        return float(np.percentile(self.calibrated.direct_rise().mean(axis=1), 90))

    def _set_exposure(self) -> float:
        white = self.devices.projector.light(np.full((*self.raster, 3), 255, np.uint8))
        self.exposure = 1.0
        brightest = np.max(self.calibrated.rise(white) + self._ambient_scale * self.calibrated.ambient())
        return float(EXPOSED / brightest)
