"""The windows of one or several projectors, each showing its region of one picture (docs/displays.md).

The renderer works in the first window's context; the other windows share its textures.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager

import glfw
import moderngl

from counterlight.errors import AbsentError, InputError
from counterlight.gl.monitors import Monitor, find_monitor, list_monitors, refuse_shared
from counterlight.gl.window import REDRAW, Window, wait_for_events
from counterlight.overlay.osd import Page, Pointer
from counterlight.raster import Region


class Displays:
    """Several windows that act as one display: keys come from any window, and requests apply to all.

    The first window shows text and views other than the projectors'; the other windows are then black.
    """

    def __init__(self, windows: Sequence[Window], regions: Sequence[Region]) -> None:
        self._windows, self._regions = windows, regions
        self._first = windows[0]
        glfw.set_monitor_callback(self._on_monitor)

    @property
    def context(self) -> moderngl.Context:
        return self._first.context

    @property
    def bits(self) -> int:
        """Bits per code value that every window can show."""
        return min(window.bits for window in self._windows)

    def attach(self, picture: Callable[[], moderngl.Texture], drive: Callable[[], bool]) -> None:
        """Set where the rendered view is found, and whether it is the raster of all projectors."""
        self._picture, self._drive = picture, drive

    @property
    def closed(self) -> bool:
        return any(window.closed for window in self._windows)

    @property
    def fullscreen(self) -> bool:
        return self._first.fullscreen

    @property
    def size(self) -> tuple[int, int]:
        return self._first.size

    @property
    def monitor(self) -> str:
        """Names of the windows' monitors, separated by commas."""
        return ", ".join(window.monitor for window in self._windows)

    def poll(self, timeout_s: float) -> list[str]:
        wait_for_events(timeout_s)
        keys = [key for window in self._windows for key in window.take_keys()]
        return [key for key in keys if key != REDRAW] + [REDRAW] * (REDRAW in keys)

    def pointers(self) -> list[Pointer]:
        return [pointer for window in self._windows for pointer in window.pointers()]

    def notices(self) -> list[str]:
        return [text for window in self._windows for text in window.notices()]

    def present(self, page: Page | None, *, black: bool) -> None:
        """Draw in every window, then show all.

        Every window finishes drawing before any is shown, so that they change together. Drawing also ends before the
        renderer, in another context, writes the next picture into the shared texture.
        """
        picture, drive = None if black else self._picture(), self._drive()
        drawn = []
        for window, region in zip(self._windows, self._regions, strict=True):
            first = window is self._first
            window.make_current()
            shown = picture if first or drive else None
            part = region if drive or picture is None else Region(0, 0, *picture.size)
            if window.visible and window.draw(shown, part, page if first else _without_text(page), grows=not drive):
                window.context.finish()
                drawn.append(window)
        for window in drawn:
            window.make_current()
            window.swap()
        self._first.make_current()

    def reload(self) -> None:
        """Recompile the presenting shader for every window."""
        try:
            for window in self._windows:
                window.reload()
        finally:
            self._first.make_current()

    def set_title(self, title: str) -> None:
        for window in self._windows:
            window.set_title(title)

    def set_fullscreen(self, on: bool) -> None:
        """Fill every projector's monitor, or none; raises InputError if a monitor is missing or named twice."""
        if on:
            refuse_shared([window.wanted_monitor for window in self._windows])
        for window in self._windows:
            window.set_fullscreen(on)

    def move_to(self, monitor: object) -> None:
        """Move the windows to monitors, given as names or numbers separated by commas."""
        names = [name.strip() for name in str(monitor).split(",")]
        for window, wanted in zip(self._windows, _find_all(names, len(self._windows)), strict=True):
            window.move_to(wanted.name)

    def identify(self) -> None:
        self._first.identify()

    def _on_monitor(self, *_: object) -> None:
        for window in self._windows:
            window.on_monitor()


@contextmanager
def open_display(
    regions: Sequence[Region],
    title: str,
    *,
    monitors: Sequence[str],
    there: bool,
    fullscreen: bool,
    exact: bool,
    vsync: bool,
    bits: int | None = None,
) -> Iterator[Window | Displays]:
    """Open a window per region; windows and context are released at the end. Raises InputError as `Window` does.

    monitors : name or number of each projector's monitor, for full screen.
    there : whether the windows open on these monitors; otherwise several windows open side by side as in the raster.
    bits : bits per code value, 8 or 10; None for each monitor's setting.
    """
    with _ending_without_monitor(), ExitStack() as stack:
        chosen: Sequence[Monitor | None] = [None] * len(regions)
        if there or fullscreen:
            chosen = _find_all(monitors, len(regions))
        windows: list[Window] = []
        for goal, region, monitor in zip(monitors, regions, chosen, strict=True):
            shape = region.height, region.width
            window = Window(
                shape,
                title,
                monitor=monitor,
                fullscreen=fullscreen,
                exact=exact,
                vsync=vsync,
                goal=goal,
                sharing=windows[0] if windows else None,
                bits=bits,
            )
            stack.callback(window.release)
            windows.append(window)
            if monitor is None and len(regions) > 1:
                window.place(region.left, region.top)
        windows[0].make_current()
        yield windows[0] if len(windows) == 1 else Displays(windows, regions)


@contextmanager
def _ending_without_monitor() -> Iterator[None]:
    """End GLFW if a monitor is missing, because GLFW notices a new monitor only while it handles events."""
    try:
        yield
    except AbsentError:
        glfw.terminate()
        raise


def _without_text(page: Page | None) -> Page | None:
    """Return the part of a page that every window shows: the outline."""
    return None if page is None or page.outline is None else Page((), outline=page.outline)


def _find_all(names: Sequence[str], count: int) -> list[Monitor]:
    """Return one monitor per projector."""
    monitors = list_monitors()
    if len(names) != count:
        raise InputError(
            f"monitors: {len(names)} named, the calibration has {count} projector{'s' * (count > 1)}; "
            "name one for each, in their order"
        )
    if len(monitors) < count > 1:
        there = "; ".join(map(str, monitors)) or "none"
        raise AbsentError(
            f"{count} projectors need as many monitors, found: {there}; connect them, or leave out --fullscreen"
        )
    chosen = [find_monitor(monitors, name) for name in names]
    refuse_shared(chosen)
    return chosen
