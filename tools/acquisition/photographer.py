"""Show and photograph pictures outside an acquisition: number them, convert captures to radiance, and average."""

from collections.abc import Sequence

import numpy as np

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.raster import Shapes
from counterlight.tools.acquisition.cameras.camera import Camera
from counterlight.tools.acquisition.cameras.together import views_of
from counterlight.tools.acquisition.plan import Picture


class Photographer:
    """Photographs pictures in a calibrated room.

    room : the calibration.
    first : number of the first capture; `taken` is the number of the next capture.
    saturated : (height, width) bool. Pixels that were at the top of the camera's range in any capture.
    """

    def __init__(self, camera: Camera, room: Calibration, first: int = 0) -> None:
        self._camera, self._room, self.taken = camera, room, first
        self._gains = room.gains
        self.saturated: BoolArray = np.zeros(room.camera.shape, np.bool_)

    def take(self, pictures: Sequence[Picture]) -> list[FloatArray]:
        """Returns the radiance of each picture, (height, width, 3); InputError for cameras of other sizes."""
        first, self.taken = self.taken, self.taken + len(pictures)
        self._camera.prepare(first, pictures, range(first, self.taken))
        return [self._radiance(first + index, picture) for index, picture in enumerate(pictures)]

    def mean(self, picture: Picture, repeats: int) -> FloatArray:
        return np.asarray(np.mean(self.take([picture] * repeats), axis=0))

    def expose(self, exposures: FloatArray) -> None:
        """Divide each camera's light by its relative exposure, (cameras, 3), from now on."""
        self._gains = self._gains / exposures

    def _radiance(self, number: int, picture: Picture) -> FloatArray:
        shots = self._camera.capture(number, picture)
        check_sizes(views_of(self._camera) or (shots[0].shape[:2],), self._room)
        seen = self._camera.exposures.radiance(shots).astype(np.float64)
        self.saturated |= self._camera.exposures.saturated(shots)
        for view, gain in zip(self._room.views, self._gains, strict=True):
            seen[view] *= gain
        return seen


def check_sizes(found: Shapes, room: Calibration, option: str = "--camera") -> None:
    """Raise InputError unless the cameras have the sizes of the calibration. `option` names cameras."""
    if found == room.cameras:
        return
    sizes, expected = (" and ".join(f"{width}x{height}" for height, width in each) for each in (found, room.cameras))
    if len(room.cameras) == 1:
        raise InputError(
            f"the camera gives {sizes}, the calibration was made with {expected}; set the camera to that size"
        )
    raise InputError(
        f"the cameras give {sizes}, the calibration was made with {expected}: name each of them with {option}, in "
        "that order, set to that size"
    )
