"""A window for a camera's live picture with a page of text, next to the projector's window; it reports keys."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from counterlight.gl.monitors import Monitor
from counterlight.gl.window import Window
from counterlight.overlay.osd import Page

CLOSED = "closed"  # a key name that no keyboard sends


class PreviewWindow:
    """A preview window.

    shape : (height, width) of its pictures.
    monitor : monitor where it opens.
    corner : (x, y) of its upper left corner on the monitor.
    """

    def __init__(self, shape: tuple[int, int], monitor: Monitor, corner: tuple[int, int]) -> None:
        self._window = Window(
            shape, "Counterlight preview", monitor=monitor, fullscreen=False, exact=False, vsync=False
        )
        self._window.place(monitor.x + corner[0], monitor.y + corner[1])
        self.shape = shape
        height, width = shape
        self._texture = self._window.context.texture((width, height), 3, alignment=1, dtype="f1")
        self._texture.filter = moderngl.NEAREST, moderngl.NEAREST
        self._window.attach(lambda: self._texture, lambda: False)

    def show(self, picture: NDArray[np.uint8], page: Page) -> list[str]:
        """Show (height, width, 3) code values; returns the keys pressed since the last call."""
        self._window.make_current()
        self._texture.write(np.ascontiguousarray(picture).tobytes())
        self._window.present(page, black=False)
        return [*self._window.poll(0), *([CLOSED] if self._window.closed else [])]

    def release(self) -> None:
        self._window.make_current()
        self._texture.release()
        self._window.release()
