"""The projector as a GLFW window: full screen on its monitor, or a plain window to try things with."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from PIL import ImageGrab

from counterlight.errors import InputError
from counterlight.gl.monitors import Monitor, find_monitor, list_monitors
from counterlight.gl.pattern_window import PatternWindow
from counterlight.tools.acquisition.plan import Codes


class WindowScreen:
    """The screen of a window; a simulated eye looks at the desktop's pixels where the window is."""

    def __init__(self, window: PatternWindow) -> None:
        self._window = window

    @property
    def shape(self) -> tuple[int, int]:
        return self._window.shape

    @property
    def place(self) -> tuple[int, int, int, int]:
        """On the desktop: (left, top, right, below)."""
        return self._window.place

    @property
    def refresh_hz(self) -> float | None:
        monitor = self._window.monitor
        return float(monitor.refresh_hz) if monitor is not None and monitor.refresh_hz else None

    def show(self, codes: Codes) -> None:
        self._window.show(codes)

    def look(self) -> Codes:
        left, top, right, below = self.place
        try:
            desktop = np.asarray(ImageGrab.grab().convert("RGB"))
        except OSError as error:
            raise InputError(f"the desktop's pixels cannot be read ({error}); start the command under X11") from None
        picture = desktop[max(top, 0) : below, max(left, 0) : right]
        if picture.shape[:2] != self.shape:
            height, width = self.shape
            raise InputError(
                f"the window of {width}x{height} at {left},{top} does not fit the desktop of {desktop.shape[1]}x"
                f"{desktop.shape[0]}; move it, or choose a smaller scene"
            )
        return picture


@contextmanager
def open_screen(shape: tuple[int, int] | None, monitor: str | None, *, desktop: bool) -> Iterator[WindowScreen]:
    """Fill a monitor, or open a window of `shape` where `monitor` is None.

    shape : (height, width); None for the monitor's own.  desktop : the monitor may be the primary one.
    Raises InputError for a monitor of another size, and for the desktop itself.
    """
    chosen = None if monitor is None else projector_monitor(list_monitors(), monitor, desktop=desktop)
    if chosen is not None and shape is None:
        shape = chosen.height, chosen.width
    if shape is None:
        raise InputError("--window needs the projector's size; add --projector WIDTHxHEIGHT")
    window = PatternWindow(shape, chosen)
    try:
        yield WindowScreen(window)
    finally:
        window.release()


def projector_monitor(monitors: list[Monitor], wanted: str, *, desktop: bool) -> Monitor:
    """The monitor that is wanted, unless it is where the user's windows are."""
    chosen = find_monitor(monitors, wanted)
    if chosen.primary and not desktop:
        others = "; ".join(str(monitor) for monitor in monitors if not monitor.primary) or "none is connected"
        raise InputError(
            f"monitor {chosen.name} is the desktop itself; the projector is another one, found: {others}; give its "
            "name or number, or add --desktop if the projector is the only monitor"
        )
    return chosen
