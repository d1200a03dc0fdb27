"""Windows for measuring: one shows still pictures pixel for pixel, another shows a camera's live picture."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.gl.monitors import Monitor
from counterlight.gl.window import Window
from counterlight.overlay.osd import Page

ESCAPE = "escape"
CLOSED = "closed"  # a key name that no keyboard sends


class _PictureWindow:
    """A window that shows one picture, `shape` (height, width), from a texture."""

    def __init__(self, window: Window, shape: tuple[int, int]) -> None:
        self._window, self.shape = window, shape
        height, width = shape
        self._texture = window.context.texture((width, height), 3, alignment=1, dtype="f1")
        self._texture.filter = moderngl.NEAREST, moderngl.NEAREST

    def _write(self, codes: NDArray[np.uint8]) -> None:
        self._window.make_current()  # another window may be current
        self._texture.write(np.ascontiguousarray(codes).tobytes())

    def release(self) -> None:
        self._window.make_current()
        self._texture.release()
        self._window.release()


class PatternWindow(_PictureWindow):
    """A window of the projector's size, or a filled monitor; black at first.

    shape : (height, width).
    monitor : monitor to fill; None for a plain window.
    """

    def __init__(self, shape: tuple[int, int], monitor: Monitor | None) -> None:
        full = monitor is not None
        window = Window(shape, "Counterlight patterns", monitor=monitor, fullscreen=full, exact=True, vsync=True)
        super().__init__(window, shape)
        self.monitor = monitor
        window.attach(lambda: self._texture)
        self.show(np.zeros((*shape, 3), np.uint8))

    @property
    def place(self) -> tuple[int, int, int, int]:
        """The picture's place on the desktop: (left, top, right, below)."""
        (x, y), (height, width) = self._window.position, self.shape
        return x, y, x + width, y + height

    def show(self, codes: NDArray[np.uint8]) -> None:
        """Show (height, width, 3) code values; returns when the driver has swapped buffers.

        Raises InputError if the window was closed or does not fill its monitor, KeyboardInterrupt after Escape.
        """
        self._write(codes)
        for _ in range(2):  # both buffers are drawn, because a driver may show either
            self._window.present(None, black=False)
            self._window.context.finish()
        if ESCAPE in self._window.poll(0):
            raise KeyboardInterrupt
        for notice in self._window.notices():
            raise InputError(f"{notice}; run the same command again to go on")
        if self._window.closed:
            raise InputError("the window of the patterns was closed; run the same command again to go on")


class PreviewWindow(_PictureWindow):
    """A plain window that shows a camera's live picture with a page of text.

    shape : (height, width) of its pictures.
    monitor : monitor where it opens.
    corner : (x, y) of its upper left corner on the monitor.
    """

    def __init__(self, shape: tuple[int, int], monitor: Monitor, corner: tuple[int, int]) -> None:
        window = Window(shape, "Counterlight preview", monitor=monitor, fullscreen=False, exact=False, vsync=False)
        window.place(monitor.x + corner[0], monitor.y + corner[1])
        super().__init__(window, shape)
        window.attach(lambda: self._texture, lambda: False)

    def show(self, picture: NDArray[np.uint8], page: Page) -> list[str]:
        """Show (height, width, 3) code values; returns the keys pressed since the last call."""
        self._write(picture)
        self._window.present(page, black=False)
        return [*self._window.poll(0), *([CLOSED] if self._window.closed else [])]
