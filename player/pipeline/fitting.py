"""A picture into its place in a target: fitted in two passes, or pinned by its corners in one."""

from counterlight.media.frames import PixelFormat
from counterlight.pipeline.device import Device, Light
from counterlight.pipeline.placement import Corners, homography, place, shown_shape
from counterlight.pipeline.reference import MOST_TAPS


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


class Pinner:
    """One pass through the projective map of the corners."""

    def __init__(self, device: Device, target: tuple[int, int]) -> None:
        self._target = target
        self._pass = device.make_pass("pinned.frag", target, {"MOST_TAPS": MOST_TAPS})

    def pin(self, corners: Corners, picture: tuple[int, int]) -> None:
        """picture : (height, width), upright."""
        self._pass.set(to_source=tuple(homography(corners, self._target, picture).T.ravel()))

    def run(self, picture: Light) -> Light:
        return self._pass.run(source=picture)

    def release(self) -> None:
        self._pass.release()
