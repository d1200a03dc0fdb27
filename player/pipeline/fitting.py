"""Places a picture in a target: fitted in two passes, or pinned by its corners in one pass."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration
from counterlight.media.frames import PixelFormat
from counterlight.pipeline.device import Device, Light, Owner
from counterlight.pipeline.placement import Corners, corners_of, homography, place, shown_shape
from counterlight.pipeline.reference import MOST_TAPS, pinned
from counterlight.screen import Screen


def on_cameras(picture: FloatArray, calibration: Calibration) -> FloatArray:
    """Return a picture (*calibration.placed_on, 3) in the camera's view, resampled if cameras share a screen."""
    screen = calibration.screen
    if screen is None:
        return picture
    return np.asarray(pinned(picture, calibration.camera.shape, np.eye(3), *screen.axes), np.float64)


class Fitter:
    """Two resampling passes: along x, then along y."""

    def __init__(self, device: Device, pixels: PixelFormat, target: tuple[int, int]) -> None:
        spot = place(pixels, target)
        between = shown_shape(pixels)[0], target[1]
        self._across = device.make_pass("resample.frag", between, axis=0, origin=spot.left, extent=spot.width)
        self._down = device.make_pass("resample.frag", target, axis=1, origin=spot.top, extent=spot.height)

    def run(self, picture: Light) -> Light:
        return self._down.run(source=self._across.run(source=picture))

    def release(self) -> None:
        self._across.release()
        self._down.release()


class Axes:
    """Pictures of the screen positions that a camera's pixels see, for a screen shared by several cameras."""

    def __init__(self, device: Device, screen: Screen) -> None:
        self.shape, self._owner = screen.shape, Owner()
        pictures = (self._owner.own(device.picture(axis)) for axis in screen.axes)
        self.pictures = dict(zip(("across", "down"), pictures, strict=True))

    def release(self) -> None:
        self._owner.release()


class Pinner:
    """One pass through the projective map of the corners. The corners refer to the target, or to a shared screen."""

    def __init__(self, device: Device, target: tuple[int, int], axes: Axes | None = None) -> None:
        self._placed_on = target if axes is None else axes.shape
        self._axes = {} if axes is None else axes.pictures
        defines = {"MOST_TAPS": MOST_TAPS} if axes is None else {"MOST_TAPS": MOST_TAPS, "SCREEN": None}
        self._pass = device.make_pass("pinned.frag", target, defines)

    def pin(self, corners: Corners, picture: tuple[int, int]) -> None:
        """Set the corners. picture : (height, width), upright."""
        self._pass.set(to_source=tuple(homography(corners, self._placed_on, picture).T.ravel()))

    def fit(self, pixels: PixelFormat) -> None:
        """Fit the picture as large as possible, with its aspect kept."""
        self.pin(corners_of(place(pixels, self._placed_on), self._placed_on), shown_shape(pixels))

    def run(self, picture: Light) -> Light:
        return self._pass.run(source=picture, **self._axes)

    def release(self) -> None:
        self._pass.release()
