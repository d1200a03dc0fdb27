"""The last pass: shows the finished picture, or a part of it, in a window, with a page of text over it."""

from dataclasses import dataclass
from typing import TypeAlias

import moderngl
import numpy as np
from numpy.typing import NDArray

from counterlight.gl.passes import ScreenPass
from counterlight.overlay.osd import Page, draw, scale_for
from counterlight.overlay.outline import Points, draw_outline
from counterlight.raster import Region

Box: TypeAlias = tuple[int, int, int, int]  # left, top, width and height, in pixels


@dataclass(frozen=True)
class Shown:
    """The region of a picture (width, height), and its place in a window."""

    region: Region
    place: Box
    size: tuple[int, int]

    def share(self, x: float, y: float) -> tuple[float, float]:
        """Convert a point of the window, in pixels, to shares of the picture."""
        left, top, width, height = self.place
        across = self.region.left + (x - left) * self.region.width / width
        down = self.region.top + (y - top) * self.region.height / height
        return across / self.size[0], down / self.size[1]


class Presenter:
    """The present pass and its overlay texture, which is replaced when a page has another size."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._none = context.texture((1, 1), 4, bytes(4), dtype="f1")
        self._overlay = context.texture((1, 1), 4, bytes(4), dtype="f1")
        self._pass = ScreenPass(context, "present.frag")
        self._drawn: tuple[Page, tuple[int, int], tuple[int, int] | None, Region, Box] | None = None

    def run(
        self,
        picture: moderngl.Texture | None,
        region: Region,
        size: tuple[int, int],
        page: Page | None,
        *,
        grows: bool = False,
    ) -> Shown | None:
        """Draw; returns the picture's place, or None without a picture."""
        shown, part = (self._none, Region(0, 0, 1, 1)) if picture is None else (picture, region)
        place = _centred((region.height, region.width), size, grows=grows)
        extent = None if picture is None else picture.size
        if page is not None and (page, size, extent, part, place) != self._drawn:
            self._drawn = page, size, extent, part, place
            self._write(overlay_of(page, size, extent, part, place))
        self._draw(self._pass, shown, self._none if page is None else self._overlay, part, place, size)
        return None if picture is None else Shown(region, place, picture.size)

    def reload(self) -> None:
        """Recompile the shader and draw once, unseen. An error is raised and keeps the old shader."""
        fresh, dot = ScreenPass(self._context, "present.frag"), Region(0, 0, 1, 1)
        try:
            self._draw(fresh, self._none, self._none, dot, dot, (1, 1))
        except BaseException:
            fresh.release()
            raise
        self._pass.release()
        self._pass = fresh

    def release(self) -> None:
        for resource in (self._pass, self._overlay, self._none):
            resource.release()

    def _draw(
        self,
        present: ScreenPass,
        picture: moderngl.Texture,
        overlay: moderngl.Texture,
        region: Region,
        place: Box,
        size: tuple[int, int],
    ) -> None:
        self._context.screen.use()
        present.set(window_size=size, region=region, place=place)
        present.draw(picture=picture, overlay=overlay)

    def _write(self, pixels: NDArray[np.uint8]) -> None:
        height, width = pixels.shape[:2]
        if self._overlay.size != (width, height):
            self._overlay.release()
            self._overlay = self._context.texture((width, height), 4, dtype="f1")
        self._overlay.write(np.ascontiguousarray(pixels))


def overlay_of(
    page: Page, size: tuple[int, int], picture: tuple[int, int] | None, region: Region, place: Box
) -> NDArray[np.uint8]:
    """Draw the overlay of a window from its upper left: (height, width, RGBA).

    size : (width, height) of the window.
    picture : (width, height); None draws no outline.
    region : part of the picture that is shown at `place`.
    """
    window = size[1], size[0]
    text = draw(page, window) if page.lines or page.legends else np.zeros((1, 1, 4), np.uint8)
    if page.outline is None or picture is None:
        return text
    left, top, width, height = place
    canvas = np.zeros((*window, 4), np.uint8)

    def in_place(points: Points) -> Points:
        scale = width / region.width, height / region.height
        return np.asarray((points * picture - (region.left, region.top)) * scale)

    draw_outline(canvas[top : top + height, left : left + width], page.outline, in_place, scale_for(window))
    canvas[: text.shape[0], : text.shape[1]][text[..., 3] > 0] = text[text[..., 3] > 0]
    return canvas


def _centred(shape: tuple[int, int], window: tuple[int, int], *, grows: bool) -> Box:
    """Return a centred box: pixel for pixel if the picture fits and must not grow, else as large as possible."""
    height, width = shape
    scale = min(window[0] / width, window[1] / height)
    scale = scale if grows else min(1.0, scale)
    shown = max(1, round(width * scale)), max(1, round(height * scale))
    return (window[0] - shown[0]) // 2, (window[1] - shown[1]) // 2, *shown
