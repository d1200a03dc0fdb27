"""Pictures shown and photographed outside an acquisition: numbered on, converted to radiance, averaged."""

from collections.abc import Sequence

import numpy as np

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import Device
from counterlight.errors import InputError
from counterlight.tools.acquisition.cameras.camera import Camera
from counterlight.tools.acquisition.plan import Picture


class Photographer:
    """device : the calibrated camera.  first : number of the first capture; `taken` is that of the next.

    saturated : (height, width), where any capture was at the top of the camera's range.
    """

    def __init__(self, camera: Camera, device: Device, first: int = 0) -> None:
        self._camera, self._device, self.taken = camera, device, first
        self.saturated: BoolArray = np.zeros(device.shape, np.bool_)

    def take(self, pictures: Sequence[Picture]) -> list[FloatArray]:
        """Radiance of one level of pictures, (height, width, 3) each; InputError for a camera of another size."""
        first, self.taken = self.taken, self.taken + len(pictures)
        self._camera.prepare(first, pictures, range(first, self.taken))
        return [self._radiance(first + index, picture) for index, picture in enumerate(pictures)]

    def mean(self, picture: Picture, repeats: int) -> FloatArray:
        return np.asarray(np.mean(self.take([picture] * repeats), axis=0))

    def _radiance(self, number: int, picture: Picture) -> FloatArray:
        shots = self._camera.capture(number, picture)
        seen = self._camera.exposures.radiance(shots)
        if seen.shape[:2] != self._device.shape:
            raise InputError(
                f"the camera gives {seen.shape[1]}x{seen.shape[0]}, the calibration was made with "
                f"{self._device.width}x{self._device.height}; set the camera to that size"
            )
        self.saturated |= self._camera.exposures.saturated(shots)
        return seen.astype(np.float64)
