"""Fills a monitor with a window that is black, undecorated and in place before it is first visible, and stays so.

On X11, the window manager is not involved, since managers interpret "full screen" differently. openbox fills the
monitor that contains the pointer. Other managers decorate first and fill later, and any manager may die. The window is
therefore override-redirect (ICCCM 4.1.10). It stays where it was put, and the server paints it black until something is
drawn.
"""

import time
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any

import glfw

from counterlight.gl import x11
from counterlight.gl.monitors import Monitor
from counterlight.gl.x11 import Box

CHECK_S = 0.1  # between checks of a window's place and of windows that cover it
AWAKE_S = 30.0  # between resets of the screen saver; screens are blanked later than this
RELEASED_S = 1.0  # longest wait; a window manager releases a hidden window within milliseconds
LAYER = "_COUNTERLIGHT_LAYER"  # window property from which the windows of several processes know their order
BYPASS = "_NET_WM_BYPASS_COMPOSITOR"


class Layer(IntEnum):
    """Stacking order on a monitor; windows of other programs are below all layers."""

    CURTAIN = 1
    PICTURE = 2
    LABEL = 3


class Filling:
    """Makes a window, which may be hidden, fill a monitor; `end` turns it into a plain window again.

    If its monitor is disconnected, the window waits in place, or is hidden if another monitor has taken this place.
    """

    def __init__(self, handle: Any, monitor: Monitor, layer: Layer) -> None:
        self._handle, self._layer, self.monitor = handle, layer, monitor
        self._checked_at = self._awake_at = float("-inf")
        self._complaint: str | None = None
        self._waits = False
        detach(handle, layer)
        self.move(monitor)

    def move(self, monitor: Monitor) -> None:
        """Fill the monitor, wherever its place on the desktop is now."""
        self.monitor, self._waits = monitor, False
        self._restack(or_below_higher=True)
        put(self._handle, monitor.box)

    def follow(self, monitors: Sequence[Monitor]) -> None:
        """Follow the monitor if its place or size has changed. monitors : the connected ones."""
        for monitor in monitors:
            if monitor.name == self.monitor.name:
                if self._waits or monitor != self.monitor:
                    self.move(monitor)
                return
        self._waits = True
        if any(monitor.box.overlaps(self.monitor.box) for monitor in monitors):
            glfw.hide_window(self._handle)

    def keep(self) -> str | None:
        """Undo what other programs did to the window, at most every CHECK_S; returns a complaint once if this fails."""
        now = time.monotonic()
        if self._waits or now - self._checked_at < CHECK_S:
            return None
        self._checked_at = now
        if not self._is_placed():
            put(self._handle, self.monitor.box)
        self._restack()
        if _on_x11() and now - self._awake_at > AWAKE_S:
            self._awake_at = now
            x11.stay_awake(_on_server(self._handle)[0])
        return self._if_new(None if self._is_placed() else self._out_of_place())

    def end(self, box: Box) -> None:
        """Turn the window into a plain window at a box of the desktop, decorated by the window manager."""
        glfw.hide_window(self._handle)
        if _on_x11():
            x11.set_unmanaged(*_on_server(self._handle), False)
            x11.set_numbers(*_on_server(self._handle), LAYER, [0])
        glfw.set_window_attrib(self._handle, glfw.DECORATED, True)
        put(self._handle, box)

    def _is_placed(self) -> bool:
        return _box_of(self._handle) == self.monitor.box

    def _out_of_place(self) -> str:
        return (
            f"monitor {self.monitor.name}: its window is {_box_of(self._handle)}, expected {self.monitor.box}; "
            "end what moves windows there, or choose an X11 session at the login"
        )

    def _if_new(self, complaint: str | None) -> str | None:
        fresh = None if complaint == self._complaint else complaint
        self._complaint = complaint
        return fresh

    def _restack(self, *, or_below_higher: bool = False) -> None:
        """Raise the window above lower layers that cover it.

        or_below_higher : also put it below higher layers.
        """
        if not _on_x11():
            return
        display, window = _on_server(self._handle)
        _, windows = x11.parent_and_children(display, x11.root_of(display))
        if window not in windows:
            return
        place, box = windows.index(window), self.monitor.box
        covered = any(
            _covers(x11.placed(display, other), box) and _layer_of(display, other) < self._layer
            for other in windows[place + 1 :]
        )
        if covered or or_below_higher:
            higher = (other for other in windows if other != window and _layer_of(display, other) > self._layer)
            x11.stack(display, window, below=next(higher, None))


def detach(handle: Any, layer: Layer) -> None:
    """Hide a window and remove it from the window manager's control permanently."""
    glfw.hide_window(handle)
    glfw.set_window_attrib(handle, glfw.DECORATED, False)
    if not _on_x11():
        return
    display, window = _on_server(handle)
    root = x11.root_of(display)
    _wait(lambda: x11.parent_and_children(display, window)[0] == root)
    x11.set_unmanaged(display, window, True)
    x11.set_numbers(display, window, LAYER, [layer])
    x11.set_numbers(display, window, BYPASS, [1])


def put(handle: Any, box: Box) -> None:
    """Show a window at a box of the desktop, in place from its first appearance."""
    glfw.set_window_size(handle, box.width, box.height)
    glfw.set_window_pos(handle, box.x, box.y)
    glfw.show_window(handle)


def take_keys(handle: Any) -> None:
    """Give the keyboard focus to a window that fills a monitor, because no window manager does."""
    if _on_x11():
        x11.take_keys(*_on_server(handle))
    else:
        glfw.focus_window(handle)


def _wait(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + RELEASED_S
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.002)


def _on_x11() -> bool:
    return bool(glfw.get_platform() == glfw.PLATFORM_X11)


def _on_server(handle: Any) -> tuple[x11.Display, int]:
    return glfw.get_x11_display(), int(glfw.get_x11_window(handle))  # type: ignore[no-untyped-call]


def _box_of(handle: Any) -> Box:
    return Box(*glfw.get_window_pos(handle), *glfw.get_window_size(handle))


def _layer_of(display: x11.Display, window: int) -> int:
    return next(iter(x11.numbers(display, window, LAYER)), 0)


def _covers(other: x11.Placed | None, box: Box) -> bool:
    return other is not None and other.viewable and other.box.overlaps(box)
