"""The last pass: the finished picture, or a part of it, in a window, with a page of text over it."""

import moderngl

from player.calibration import Region
from player.gl.passes import ScreenPass
from player.show.osd import Page, draw


class Presenter:
    """The present pass and its overlay texture, made anew when a page has another size."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._none = context.texture((1, 1), 4, bytes(4), dtype="f1")
        self._overlay = context.texture((1, 1), 4, bytes(4), dtype="f1")
        self._pass = ScreenPass(context, "present.frag")
        self._drawn: tuple[Page, tuple[int, int]] | None = None

    def run(self, picture: moderngl.Texture | None, region: Region, size: tuple[int, int], page: Page | None) -> None:
        if page is not None and (page, size) != self._drawn:
            self._draw_page(page, size)
        shown, part = (self._none, Region(0, 0, 1, 1)) if picture is None else (picture, region)
        place = _centred((region.height, region.width), size)
        self._draw(self._pass, shown, self._none if page is None else self._overlay, part, place, size)

    def reload(self) -> None:
        """Compile the shader again and draw with it once, unseen; an error, which is raised, leaves the old one."""
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
        place: tuple[int, int, int, int],
        size: tuple[int, int],
    ) -> None:
        self._context.screen.use()
        present.set(window_size=size, region=region, place=place)
        present.draw(picture=picture, overlay=overlay)

    def _draw_page(self, page: Page, size: tuple[int, int]) -> None:
        pixels = draw(page, (size[1], size[0]))
        height, width = pixels.shape[:2]
        if self._overlay.size != (width, height):
            self._overlay.release()
            self._overlay = self._context.texture((width, height), 4, dtype="f1")
        self._overlay.write(pixels)
        self._drawn = page, size


def _centred(shape: tuple[int, int], window: tuple[int, int]) -> tuple[int, int, int, int]:
    """(left, top, width, height): pixel for pixel and centred if the window is large enough, else shrunk to fit."""
    height, width = shape
    scale = min(1.0, window[0] / width, window[1] / height)
    shown = max(1, round(width * scale)), max(1, round(height * scale))
    return (window[0] - shown[0]) // 2, (window[1] - shown[1]) // 2, *shown
