"""A picture into its place in a target: fitted in two passes, or pinned by its corners in one."""

import moderngl

from counterlight.gl.passes import Pass, float_texture
from counterlight.placement import Corners, homography, place, shown_shape
from counterlight.reference import MOST_TAPS
from counterlight.video import PixelFormat


class Fitter:
    """Two resampling passes: along x, then along y."""

    def __init__(self, context: moderngl.Context, pixels: PixelFormat, target: tuple[int, int]) -> None:
        spot = place(pixels, target)
        between = float_texture(context, (shown_shape(pixels)[0], target[1]))
        self._across = Pass(context, "resample.frag", between, axis=0, origin=spot.left, extent=spot.width)
        self._down = Pass(
            context, "resample.frag", float_texture(context, target), axis=1, origin=spot.top, extent=spot.height
        )

    def run(self, picture: moderngl.Texture) -> moderngl.Texture:
        return self._down.run(source=self._across.run(source=picture))

    def release(self) -> None:
        self._across.release()
        self._down.release()


class Pinner:
    """One pass through the projective map of the corners."""

    def __init__(self, context: moderngl.Context, target: tuple[int, int]) -> None:
        self._target = target
        defines: dict[str, int | None] = {"MOST_TAPS": MOST_TAPS}
        self._pass = Pass(context, "pinned.frag", float_texture(context, target), defines)

    def pin(self, corners: Corners, picture: tuple[int, int]) -> None:
        """picture : (height, width), upright."""
        self._pass.set(to_source=tuple(homography(corners, self._target, picture).T.ravel()))

    def run(self, picture: moderngl.Texture) -> moderngl.Texture:
        return self._pass.run(source=picture)

    def release(self) -> None:
        self._pass.release()
