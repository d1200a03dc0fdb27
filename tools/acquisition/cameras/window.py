"""Projectors as GLFW windows: full screen on their monitors, or a plain window for trials."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

import numpy as np
from PIL import ImageGrab

from counterlight.errors import InputError
from counterlight.gl.monitors import Monitor, find_monitor, list_monitors, refuse_shared
from counterlight.gl.pattern_window import PatternWindow
from counterlight.raster import Shape, Shapes, side_by_side
from counterlight.tools.acquisition.cameras.simulated import VisibleScreen
from counterlight.tools.acquisition.plan import Codes


class WindowScreen:
    """The screen of a window; a simulated camera reads the desktop's pixels at the window's position."""

    def __init__(self, window: PatternWindow) -> None:
        self._window = window

    @property
    def shape(self) -> tuple[int, int]:
        return self._window.shape

    @property
    def place(self) -> tuple[int, int, int, int]:
        """Position on the desktop: (left, top, right, below)."""
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


class SideBySide:
    """Screens of several projectors, in order from the left, that together show the raster as one screen."""

    def __init__(self, screens: Sequence[VisibleScreen]) -> None:
        self._screens = screens

    @property
    def shape(self) -> Shape:
        return side_by_side(self._shapes)[0]

    @property
    def refresh_hz(self) -> float | None:
        """The lowest refresh rate; None if a rate is unknown."""
        known = [screen.refresh_hz for screen in self._screens]
        return min((hz for hz in known if hz is not None), default=None) if None not in known else None

    def show(self, codes: Codes) -> None:
        for screen, region in zip(self._screens, side_by_side(self._shapes)[1], strict=True):
            screen.show(np.ascontiguousarray(codes[region.part]))

    def look(self) -> Codes:
        shape, regions = side_by_side(self._shapes)
        seen = np.zeros((*shape, 3), np.uint8)
        for screen, region in zip(self._screens, regions, strict=True):
            seen[region.part] = screen.look()
        return seen

    @property
    def _shapes(self) -> list[Shape]:
        return [screen.shape for screen in self._screens]


@contextmanager
def open_screens(
    shapes: Shapes, monitors: Sequence[str], *, desktop: bool
) -> Iterator[tuple[WindowScreen | SideBySide, Shapes]]:
    """Fill one monitor per projector, or open one window for all projectors if no monitor is named.

    shapes : (height, width) of each projector; empty to use the monitors' sizes.
    desktop : whether the primary monitor may be used.

    Yields the screen of the raster and the shapes.
    Raises InputError for a wrong number or size of monitors, a monitor named twice, and the desktop itself.
    """
    if not monitors:
        if not shapes:
            raise InputError("--window needs the projector's size; add --projector WIDTHxHEIGHT")
        with _opened(side_by_side(shapes)[0], None) as screen:
            yield screen, shapes
        return
    if shapes and len(shapes) != len(monitors):
        raise InputError(
            f"--monitor: {len(monitors)} given, of projectors {len(shapes)}; give one for each, from the left"
        )
    there = list_monitors()
    chosen = [projector_monitor(there, name, desktop=desktop) for name in monitors]
    refuse_shared(chosen)
    shapes = shapes or tuple((monitor.height, monitor.width) for monitor in chosen)
    with ExitStack() as opened:
        screens = [opened.enter_context(_opened(shape, monitor)) for shape, monitor in zip(shapes, chosen, strict=True)]
        yield (screens[0] if len(screens) == 1 else SideBySide(screens)), shapes


@contextmanager
def _opened(shape: tuple[int, int], monitor: Monitor | None) -> Iterator[WindowScreen]:
    window = PatternWindow(shape, monitor)
    try:
        yield WindowScreen(window)
    finally:
        window.release()


def projector_monitor(monitors: list[Monitor], wanted: str, *, desktop: bool) -> Monitor:
    """Returns the monitor that is wanted; InputError if it is the desktop and `desktop` is False."""
    chosen = find_monitor(monitors, wanted)
    if chosen.primary and not desktop:
        others = "; ".join(str(monitor) for monitor in monitors if not monitor.primary) or "none is connected"
        raise InputError(
            f"monitor {chosen.name} is the desktop itself; the projector is another one, found: {others}; give its "
            "name or number, or add --desktop if the projector is the only monitor"
        )
    return chosen
