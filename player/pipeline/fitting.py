"""Places a picture in a target: fitted in two passes, or pinned by its corners in one pass."""

from typing import Generic

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration
from counterlight.media.frames import PixelFormat
from counterlight.passes.drawing import Picture
from counterlight.passes.pinned import OnScreen, Pinned, pinned
from counterlight.passes.resample import Resample
from counterlight.pipeline.device import Device, Owner, Owning
from counterlight.pipeline.placement import Corners, corners_of, homography, place, shown_shape
from counterlight.screen import Screen


def on_cameras(picture: FloatArray, calibration: Calibration) -> FloatArray:
    """Return a picture (*calibration.placed_on, 3) in the camera's view, resampled if cameras share a screen."""
    screen = calibration.screen
    if screen is None:
        return picture
    return np.asarray(pinned(picture, calibration.camera.shape, np.eye(3), *screen.axes), np.float64)


class Fitter(Generic[Picture]):
    """Two resampling passes: along x, then along y."""

    def __init__(self, device: Device[Picture], pixels: PixelFormat, target: tuple[int, int]) -> None:
        spot = place(pixels, target)
        between = shown_shape(pixels)[0], target[1]
        self._spot, self._across, self._down = spot, device.canvas(between), device.canvas(target)

    def run(self, picture: Picture) -> Picture:
        across = self._across.draw(Resample(picture, 0, self._spot.left, self._spot.width))
        return self._down.draw(Resample(across, 1, self._spot.top, self._spot.height))

    def release(self) -> None:
        self._across.release()
        self._down.release()


class Axes(Owning, Generic[Picture]):
    """Pictures of the screen positions that a camera's pixels see, for a screen shared by several cameras."""

    def __init__(self, device: Device[Picture], screen: Screen) -> None:
        self.shape, self._owner = screen.shape, Owner()
        self.on_screen = OnScreen(*(self._owner.own(device.picture(axis)) for axis in screen.axes))


class Pinner(Generic[Picture]):
    """One pass through the projective map of the corners. The corners refer to the target, or to a shared screen."""

    def __init__(self, device: Device[Picture], target: tuple[int, int], axes: Axes[Picture] | None = None) -> None:
        self._placed_on = target if axes is None else axes.shape
        self._on_screen = None if axes is None else axes.on_screen
        self._canvas = device.canvas(target)

    def pin(self, corners: Corners, picture: tuple[int, int]) -> None:
        """Set the corners. picture : (height, width), upright."""
        self._to_source = tuple(homography(corners, self._placed_on, picture).T.ravel())

    def fit(self, pixels: PixelFormat) -> None:
        """Fit the picture as large as possible, with its aspect kept."""
        self.pin(corners_of(place(pixels, self._placed_on), self._placed_on), shown_shape(pixels))

    def run(self, picture: Picture) -> Picture:
        return self._canvas.draw(Pinned(picture, self._to_source, self._on_screen))

    def release(self) -> None:
        self._canvas.release()
