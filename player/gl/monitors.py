"""Screens: GLFW started with plain errors, the monitors it sees, and the one that the user means.

X11 needs libXrandr at run time: without it GLFW sees one monitor named "Display", whatever is plugged in.
"""

import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import glfw

from counterlight.command import tell
from counterlight.errors import InputError
from counterlight.gl import lost_screen, x11
from counterlight.gl.x11 import Box

WITHOUT_SCREEN = "use --output FILE to render without one, or start one with: xvfb-run -a COMMAND"
WITHOUT_XWAYLAND = (
    "this Wayland session has no X server; install one (apt-get install xwayland) and log in again, "
    "choose an X11 session at the login, or use --output FILE"
)
MANAGER = "_NET_SUPPORTING_WM_CHECK"
STARTS_S = 1.0  # a window manager that starts needs milliseconds between the two properties


@dataclass(frozen=True)
class Monitor:
    """One monitor as it is set now: size in pixels of its video mode, position on the desktop, bits of a code value."""

    index: int
    name: str
    width: int
    height: int
    refresh_hz: int
    x: int
    y: int
    primary: bool
    bits: int = 8

    @property
    def box(self) -> Box:
        """Its place on the desktop."""
        return Box(self.x, self.y, self.width, self.height)

    def __str__(self) -> str:
        primary = (f", {self.bits} bits" if self.bits > 8 else "") + (", primary" if self.primary else "")
        return (
            f"{self.index} {self.name} ({self.width}x{self.height} at {self.x},{self.y}, {self.refresh_hz} Hz{primary})"
        )


def start_glfw() -> None:
    """Start GLFW, or do nothing if it runs; InputError if there is no screen to open a window on."""
    _check_server()
    with raising():
        try:
            started = glfw.init()
        except glfw.GLFWError as error:
            raise InputError(f"no screen: {_plain(error)}; {WITHOUT_SCREEN}") from None
    if not started:
        raise InputError(f"no screen: GLFW does not start and gives no reason; {WITHOUT_SCREEN}")
    lost_screen.watch()


@cache
def _check_server() -> None:
    """What must hold before GLFW starts; InputError for a Wayland session without an X server.

    GLFW 3.4 fails in an assertion when it opens a window after the window manager has died, since the root window
    still has a property that names the manager's window. That property is deleted, as the next manager would do.
    """
    if os.environ.get("WAYLAND_DISPLAY") and not os.environ.get("DISPLAY"):
        raise InputError(f"no screen: {WITHOUT_XWAYLAND}")
    with x11.connection() as display:
        if display is None:
            return
        root, deadline = x11.root_of(display), time.monotonic() + STARTS_S
        while (named := x11.numbers(display, root, MANAGER)) and not x11.numbers(display, named[0], MANAGER):
            if time.monotonic() > deadline:
                x11.forget(display, root, MANAGER)
                tell("the window manager has died; going on without one")
            time.sleep(0.05)


def list_monitors() -> list[Monitor]:
    """The monitors that are connected now, the primary one first, names unique; InputError without a screen.

    Starts GLFW if nobody has, and leaves it running.
    """
    start_glfw()
    with raising():
        try:
            handles = glfw.get_monitors()
            names = _unique([_text(glfw.get_monitor_name(handle)) for handle in handles])
            return [_describe(index, name, handles[index]) for index, name in enumerate(names)]
        except glfw.GLFWError as error:
            raise InputError(
                f"the monitors cannot be listed: {_plain(error)}; unplug and replug, or try again"
            ) from None


def find_monitor(monitors: Sequence[Monitor], name_or_index: str | int) -> Monitor:
    """The monitor of that name or, failing that, of that index; InputError naming the ones that exist."""
    wanted = str(name_or_index)
    for key in ("name", "index"):
        for monitor in monitors:
            if str(getattr(monitor, key)) == wanted:
                return monitor
    there = "; ".join(map(str, monitors)) or "none is connected"
    raise InputError(f"monitor {wanted!r}: not there, found: {there}; give one of these names or numbers")


def refuse_shared(monitors: Sequence[Monitor]) -> None:
    """InputError if one is named for two projectors."""
    for number, monitor in enumerate(monitors):
        if monitor in monitors[:number]:
            raise InputError(f"monitor {monitor.name}: named for two projectors; each has its own")


def after_a_change(
    home: str | None, monitors: Sequence[Monitor], *, at_home: bool
) -> Literal["stay", "return", "left"]:
    """What a window does when monitors come or go: nothing, go back to its monitor, or say that it has gone.

    home : name of the monitor that the window belongs on; None for any.  at_home : whether it was there until now.
    """
    there = home in {monitor.name for monitor in monitors}
    if home is None or there == at_home:
        return "stay"
    return "return" if there else "left"


def bits_of_code(channels: Iterable[int]) -> int:
    """8, or 10 where every channel has as many.  channels : the bits of each."""
    return 10 if min(channels) >= 10 else 8


def _describe(index: int, name: str, handle: Any) -> Monitor:
    mode = glfw.get_video_mode(handle)
    x, y = glfw.get_monitor_pos(handle)
    # GLFW lists the primary monitor first.
    size, bits = mode.size, bits_of_code(mode.bits)
    return Monitor(index, name, size.width, size.height, mode.refresh_rate, x, y, index == 0, bits)


def _unique(names: Sequence[str]) -> list[str]:
    """Two projectors of one make share a name: the second becomes `name (2)`."""
    result: list[str] = []
    for name in names:
        candidate, count = name, 1
        while candidate in result:
            count += 1
            candidate = f"{name} ({count})"
        result.append(candidate)
    return result


@contextmanager
def raising() -> Iterator[None]:
    """GLFW's errors as exceptions for a while; elsewhere its mere complaints must not stop a running player."""
    previous, glfw.ERROR_REPORTING = glfw.ERROR_REPORTING, "raise"
    try:
        yield
    finally:
        glfw.ERROR_REPORTING = previous


def _text(name: str | bytes) -> str:
    return name.decode(errors="replace") if isinstance(name, bytes) else name


def _plain(error: Exception) -> str:
    """`(65550) b'X11: The DISPLAY …'` -> `X11: The DISPLAY …`."""
    return str(error).partition(") ")[2].removeprefix("b").strip("'\"") or str(error)
