"""Several cameras that photograph every pattern; a capture holds their pictures below each other."""

from collections.abc import Sequence

import numpy as np

from counterlight.errors import InputError
from counterlight.screen import parts_of, raster_of
from counterlight.tools.acquisition.cameras.camera import Camera, Shot
from counterlight.tools.acquisition.cameras.live import CameraDevice, LiveCamera

Shape = tuple[int, int]


class JoinedDevices:
    """Joins cameras: narrower pictures are padded with black, and all cameras share the exposures."""

    def __init__(self, devices: Sequence[CameraDevice]) -> None:
        self._devices = tuple(devices)
        self._shapes: tuple[Shape, ...] = ()

    @property
    def name(self) -> str:
        return " + ".join(device.name for device in self._devices)

    @property
    def timed(self) -> bool:
        return any(device.timed for device in self._devices)

    @property
    def views(self) -> tuple[Shape, ...]:
        """(height, width) of each camera's pictures."""
        if not self._shapes:
            self.frame()
        return self._shapes

    def begin(self, number: int) -> None:
        for device in self._devices:
            device.begin(number)

    def expose(self, time: float) -> None:
        for device in self._devices:
            device.expose(time)

    def skip(self) -> None:
        for device in self._devices:
            device.skip()

    def last(self) -> Shot:
        shots = [device.last() for device in self._devices]
        kinds = {(shot.dtype, shot.ndim) for shot in shots}
        if len(kinds) > 1:
            said = ", ".join(f"{shot.dtype} {'colour' if shot.ndim == 3 else 'grey'}" for shot in shots)
            raise InputError(
                f"cameras whose captures differ ({said}); set all to the same depth, all to colour or grey"
            )
        self._shapes = tuple((shot.shape[0], shot.shape[1]) for shot in shots)
        together = np.zeros((*raster_of(self._shapes), *shots[0].shape[2:]), shots[0].dtype)
        for part, shot in zip(parts_of(self._shapes), shots, strict=True):
            together[part] = shot
        return together

    def frame(self) -> Shot:
        self.skip()
        return self.last()


def together(devices: Sequence[CameraDevice]) -> CameraDevice:
    """Joins several sources of frames; a single source is returned unchanged."""
    return devices[0] if len(devices) == 1 else JoinedDevices(devices)


def views_of(camera: Camera) -> tuple[Shape, ...]:
    """Returns the (height, width) of each of several cameras in one capture; empty for a single camera."""
    device = _devices_of(camera)
    return () if device is None else device.views


def _devices_of(camera: Camera) -> JoinedDevices | None:
    device = camera.device if isinstance(camera, LiveCamera) else None
    return device if isinstance(device, JoinedDevices) else None
