"""Xlib calls that GLFW lacks: windows that no window manager may touch (Xlib manual, chapters 3, 4), and a lost server.

GLFW has loaded the same library, so its display and its windows are valid here. Xlib ends a process whose server is
lost. The handler here ends it first, with one line.
"""

import ctypes
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, TypeAlias

from counterlight.command import BAD_INPUT, tell

Display: TypeAlias = Any  # Display*, as glfw.get_x11_display() returns it

_BACK_PIXEL, _OVERRIDE_REDIRECT = 1 << 1, 1 << 9  # masks of XChangeWindowAttributes
_SIBLING, _STACK_MODE, _ABOVE, _BELOW = 1 << 5, 1 << 6, 0, 1  # masks and values of XConfigureWindow
_VIEWABLE, _POINTER_ROOT, _NOW, _REPLACE, _ANY_TYPE = 2, 1, 0, 0, 0
_CARDINAL, _SCREEN_SAVER_RESET, _MOST = 6, 0, 64
_Window, _Atom = ctypes.c_ulong, ctypes.c_ulong
_farewells: list[Callable[[], object]] = []


class _SetAttributes(ctypes.Structure):
    """Xlib's structure XSetWindowAttributes."""

    _fields_ = [
        *((name, ctypes.c_ulong) for name in ("background_pixmap", "background_pixel", "border_pixmap", "border")),
        *((name, ctypes.c_int) for name in ("bit_gravity", "win_gravity", "backing_store")),
        *((name, ctypes.c_ulong) for name in ("backing_planes", "backing_pixel")),
        ("save_under", ctypes.c_int),
        *((name, ctypes.c_long) for name in ("event_mask", "do_not_propagate_mask")),
        ("override_redirect", ctypes.c_int),
        *((name, ctypes.c_ulong) for name in ("colormap", "cursor")),
    ]


class _Attributes(ctypes.Structure):
    """Xlib's structure XWindowAttributes."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("x", "y", "width", "height", "border_width", "depth")),
        ("visual", ctypes.c_void_p),
        ("root", ctypes.c_ulong),
        *((name, ctypes.c_int) for name in ("window_class", "bit_gravity", "win_gravity", "backing_store")),
        *((name, ctypes.c_ulong) for name in ("backing_planes", "backing_pixel")),
        ("save_under", ctypes.c_int),
        ("colormap", ctypes.c_ulong),
        *((name, ctypes.c_int) for name in ("map_installed", "map_state")),
        *((name, ctypes.c_long) for name in ("all_event_masks", "your_event_mask", "do_not_propagate_mask")),
        ("override_redirect", ctypes.c_int),
        ("screen", ctypes.c_void_p),
    ]


class _Changes(ctypes.Structure):
    """Xlib's structure XWindowChanges."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("x", "y", "width", "height", "border_width")),
        ("sibling", ctypes.c_ulong),
        ("stack_mode", ctypes.c_int),
    ]


class Box(NamedTuple):
    """A rectangle of the desktop, in pixels."""

    x: int
    y: int
    width: int
    height: int

    def overlaps(self, other: "Box") -> bool:
        across = self.x < other.x + other.width and other.x < self.x + self.width
        return across and self.y < other.y + other.height and other.y < self.y + self.height

    def __str__(self) -> str:
        return f"{self.width}x{self.height} at {self.x},{self.y}"


@dataclass(frozen=True)
class Placed:
    """A window's box within its parent, and whether the window and all its parents are mapped."""

    box: Box
    viewable: bool


@cache
def _xlib() -> Any:
    library = ctypes.CDLL("libX11.so.6")
    pointer, number, mask = ctypes.c_void_p, ctypes.c_int, ctypes.c_ulong
    for name, result, *arguments in (
        ("XInitThreads", number),
        ("XOpenDisplay", pointer, ctypes.c_char_p),
        ("XCloseDisplay", number, pointer),
        ("XDefaultRootWindow", _Window, pointer),
        ("XInternAtom", _Atom, pointer, ctypes.c_char_p, number),
        ("XGetWindowAttributes", number, pointer, _Window, pointer),
        ("XChangeWindowAttributes", number, pointer, _Window, mask, pointer),
        ("XConfigureWindow", number, pointer, _Window, ctypes.c_uint, pointer),
        ("XQueryTree", number, pointer, _Window, pointer, pointer, pointer, pointer),
        ("XChangeProperty", number, pointer, _Window, _Atom, _Atom, number, number, pointer, number),
        ("XDeleteProperty", number, pointer, _Window, _Atom),
        (
            *("XGetWindowProperty", number, pointer, _Window, _Atom, ctypes.c_long, ctypes.c_long, number),
            *(_Atom, pointer, pointer, pointer, pointer, pointer),
        ),
        ("XSetInputFocus", number, pointer, _Window, number, mask),
        ("XForceScreenSaver", number, pointer, number),
        ("XSetErrorHandler", pointer, pointer),
        ("XSync", number, pointer, number),
        ("XFree", number, pointer),
    ):
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def _ignore(_display: int, _event: int) -> int:
    return 0


_ignored = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(_ignore)


@contextmanager
def _tolerating(display: Display) -> Iterator[Any]:
    """Yield Xlib with errors ignored: by default, errors end the process, as when another program's window vanishes."""
    xlib = _xlib()
    xlib.XSync(display, False)
    before = xlib.XSetErrorHandler(_ignored)
    try:
        yield xlib
        xlib.XSync(display, False)
    finally:
        xlib.XSetErrorHandler(before)


@contextmanager
def connection() -> Iterator[Display | None]:
    """Open a separate connection to the server that DISPLAY names, closed at the end; None without a server."""
    try:
        xlib = _xlib()
    except OSError:  # no Xlib: GLFW reports it
        yield None
        return
    xlib.XInitThreads()  # before all other calls; GLFW does the same at its start
    display = xlib.XOpenDisplay(None)
    try:
        yield display
    finally:
        if display:
            xlib.XCloseDisplay(display)


def root_of(display: Display) -> int:
    return int(_xlib().XDefaultRootWindow(display))


def parent_and_children(display: Display, window: int) -> tuple[int, list[int]]:
    """Return a window's parent, and its children from lowest to highest; 0 and an empty list if the window is gone."""
    root, parent, count = _Window(), _Window(), ctypes.c_uint()
    found = ctypes.POINTER(_Window)()
    with _tolerating(display) as xlib:
        references = map(ctypes.byref, (root, parent, found, count))
        if not xlib.XQueryTree(display, window, *references):
            return 0, []
        children = [int(found[index]) for index in range(count.value)]
        if found:
            xlib.XFree(found)
    return int(parent.value), children


def placed(display: Display, window: int) -> Placed | None:
    """Return a window's place within its parent; None if the window is gone."""
    found = _Attributes()
    with _tolerating(display) as xlib:
        if not xlib.XGetWindowAttributes(display, window, ctypes.byref(found)):
            return None
    return Placed(Box(found.x, found.y, found.width, found.height), found.map_state == _VIEWABLE)


def set_unmanaged(display: Display, window: int, on: bool) -> None:
    """Set whether window managers ignore an unmapped window (override-redirect).

    Once the window is mapped, the server paints black what was never drawn.
    """
    wanted = _SetAttributes(background_pixel=0, override_redirect=on)
    with _tolerating(display) as xlib:
        xlib.XChangeWindowAttributes(display, window, _BACK_PIXEL | _OVERRIDE_REDIRECT, ctypes.byref(wanted))


def stack(display: Display, window: int, *, below: int | None) -> None:
    """Raise a window to the top, or put it directly below another window."""
    mask = _STACK_MODE if below is None else _STACK_MODE | _SIBLING
    changes = _Changes(sibling=below or 0, stack_mode=_ABOVE if below is None else _BELOW)
    with _tolerating(display) as xlib:
        xlib.XConfigureWindow(display, window, mask, ctypes.byref(changes))


def take_keys(display: Display, window: int) -> None:
    """Give the keyboard focus to a window; if the window disappears, the focus follows the pointer."""
    with _tolerating(display) as xlib:
        xlib.XSetInputFocus(display, window, _POINTER_ROOT, _NOW)


def stay_awake(display: Display) -> None:
    """Restart the delay after which the server blanks its screens or switches monitors off."""
    with _tolerating(display) as xlib:
        xlib.XForceScreenSaver(display, _SCREEN_SAVER_RESET)


def numbers(display: Display, window: int, name: str) -> list[int]:
    """Return a window's property of 32-bit numbers; empty if the property or the window does not exist."""
    kind, width, count, left = _Atom(), ctypes.c_int(), ctypes.c_ulong(), ctypes.c_ulong()
    found = ctypes.POINTER(ctypes.c_ulong)()
    with _tolerating(display) as xlib:
        atom = xlib.XInternAtom(display, name.encode(), False)
        references = map(ctypes.byref, (kind, width, count, left, found))
        failed = xlib.XGetWindowProperty(display, window, atom, 0, _MOST, False, _ANY_TYPE, *references)
        if failed or not found:
            return []
        values = [int(found[index]) for index in range(count.value)] if width.value == 32 else []
        xlib.XFree(found)
    return values


def set_numbers(display: Display, window: int, name: str, values: Sequence[int]) -> None:
    stored = (ctypes.c_ulong * len(values))(*values)
    with _tolerating(display) as xlib:
        atom = xlib.XInternAtom(display, name.encode(), False)
        xlib.XChangeProperty(display, window, atom, _CARDINAL, 32, _REPLACE, stored, len(values))


def forget(display: Display, window: int, name: str) -> None:
    """Delete a property."""
    with _tolerating(display) as xlib:
        xlib.XDeleteProperty(display, window, xlib.XInternAtom(display, name.encode(), False))


@contextmanager
def farewell(act: Callable[[], object]) -> Iterator[None]:
    """Register an action to run before the process ends because its screen is lost; it must not need the screen."""
    _farewells.append(act)
    try:
        yield
    finally:
        _farewells.remove(act)


def end_in_words() -> None:
    """Report the loss of the X server in one line; does nothing without Xlib."""
    with suppress(OSError):
        ctypes.CDLL("libX11.so.6").XSetIOErrorHandler(_on_loss)


def _lost(_display: int) -> int:
    """Handle the loss. Must not return (XSetIOErrorHandler(3)); an exception would be lost on its way through Xlib."""
    for act in reversed(_farewells):
        with suppress(Exception):
            act()
    tell("error: the screen has gone, the X server ended; start again when it is back", patience_s=1.0)
    os._exit(BAD_INPUT)


# a reference must exist as long as the process, because Xlib keeps the pointer
_on_loss = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)(_lost)
