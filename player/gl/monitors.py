"""Screens: starts GLFW with readable errors, lists the monitors, and finds the one that the user names.

X11 needs libXrandr at run time: without it, GLFW sees one monitor named "Display", whatever is connected.
"""

import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import glfw

from counterlight.command import tell
from counterlight.errors import AbsentError, InputError
from counterlight.gl import x11
from counterlight.gl.x11 import Box

WITHOUT_SCREEN = "start one, such as with: xvfb-run -a COMMAND; counterlight play --output FILE needs none"
WITHOUT_XWAYLAND = (
    "this Wayland session has no X server; install one (apt-get install xwayland) and log in again, or choose an X11 "
    "session at the login; counterlight play --output FILE needs none"
)
MANAGER = "_NET_SUPPORTING_WM_CHECK"
USUAL_HZ = 60
STARTS_S = 1.0  # longest wait; a starting window manager needs milliseconds between the two properties


@dataclass(frozen=True)
class Monitor:
    """One monitor as it is set now: size in pixels of its video mode, position on the desktop, bits per code value."""

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
        """The monitor's place on the desktop."""
        return Box(self.x, self.y, self.width, self.height)

    def __str__(self) -> str:
        primary = (f", {self.bits} bits" if self.bits > 8 else "") + (", primary" if self.primary else "")
        return (
            f"{self.index} {self.name} ({self.width}x{self.height} at {self.x},{self.y}, {self.refresh_hz} Hz{primary})"
        )


def start_glfw() -> None:
    """Start GLFW, or do nothing if it runs; raises AbsentError without a screen."""
    if _glfw_runs():
        return
    with _checked_server(), raising():
        try:
            started = glfw.init()
        except glfw.GLFWError as error:
            raise AbsentError(f"no screen: {_plain(error)}; {WITHOUT_SCREEN}") from None
    if not started:
        raise AbsentError(f"no screen: GLFW does not start and gives no reason; {WITHOUT_SCREEN}")
    x11.end_in_words()


def _glfw_runs() -> bool:
    with raising():
        try:
            glfw.get_platform()
        except glfw.GLFWError:
            return False
    return True


@contextmanager
def _checked_server() -> Iterator[None]:
    """Check the X server while GLFW starts; raises InputError for a Wayland session without an X server.

    The connection stays open until GLFW has connected, because Xvfb resets when its last client leaves.

    After a window manager has died, the root window keeps a property that names its window. GLFW 3.4 then fails an
    assertion when it opens a window. This function deletes the property, as the next window manager would.
    """
    if os.environ.get("WAYLAND_DISPLAY") and not os.environ.get("DISPLAY"):
        raise InputError(f"no screen: {WITHOUT_XWAYLAND}")
    with x11.connection() as display:
        if display is None:
            yield
            return
        root, deadline = x11.root_of(display), time.monotonic() + STARTS_S
        while (named := x11.numbers(display, root, MANAGER)) and not x11.numbers(display, named[0], MANAGER):
            if time.monotonic() > deadline:
                x11.forget(display, root, MANAGER)
                tell("the window manager has died; going on without one")
            time.sleep(0.05)
        yield


def list_monitors() -> list[Monitor]:
    """Return the connected monitors, the primary one first, with unique names; raises AbsentError without a screen.

    Starts GLFW if needed, and leaves it running.
    """
    start_glfw()
    with raising():
        try:
            handles = glfw.get_monitors()
            names = _unique([_text(glfw.get_monitor_name(handle)) for handle in handles])
            return [_describe(index, name, handles[index]) for index, name in enumerate(names)]
        except glfw.GLFWError as error:
            raise AbsentError(
                f"the monitors cannot be listed: {_plain(error)}; unplug and replug, or try again"
            ) from None


def find_monitor(monitors: Sequence[Monitor], name_or_index: str | int) -> Monitor:
    """Return the monitor of that name or, failing that, of that index; raises AbsentError with a list of monitors."""
    wanted = str(name_or_index)
    for key in ("name", "index"):
        for monitor in monitors:
            if str(getattr(monitor, key)) == wanted:
                return monitor
    there = "; ".join(map(str, monitors)) or "none is connected"
    raise AbsentError(f"monitor {wanted!r}: not there, found: {there}; give one of these names or numbers")


def refresh_s(names: str) -> float:
    """Return the period of the first of these monitors; 1/60 s if it is unknown."""
    known = {monitor.name: monitor.refresh_hz for monitor in list_monitors()}
    return 1 / (known.get(names.partition(", ")[0]) or USUAL_HZ)


def refuse_shared(monitors: Sequence[Monitor]) -> None:
    """Raise InputError if a monitor is named for two projectors."""
    for number, monitor in enumerate(monitors):
        if monitor in monitors[:number]:
            raise InputError(f"monitor {monitor.name}: named for two projectors; each has its own")


def after_a_change(
    home: str | None, monitors: Sequence[Monitor], *, at_home: bool
) -> Literal["stay", "return", "left"]:
    """Return what a window does after monitors changed: nothing, return to its monitor, or report the loss.

    home : name of the monitor that the window belongs on; None for any.
    at_home : whether the window was on that monitor until now.
    """
    there = home in {monitor.name for monitor in monitors}
    if home is None or there == at_home:
        return "stay"
    return "return" if there else "left"


def bits_of_code(channels: Iterable[int]) -> int:
    """Return 10 if every channel has at least 10 bits, else 8. channels : bits of each channel."""
    return 10 if min(channels) >= 10 else 8


def _describe(index: int, name: str, handle: Any) -> Monitor:
    mode = glfw.get_video_mode(handle)
    x, y = glfw.get_monitor_pos(handle)
    # GLFW lists the primary monitor first.
    size, bits = mode.size, bits_of_code(mode.bits)
    return Monitor(index, name, size.width, size.height, mode.refresh_rate, x, y, index == 0, bits)


def _unique(names: Sequence[str]) -> list[str]:
    """Make names unique: two projectors of one make share a name, so the second becomes `name (2)`."""
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
    """Raise GLFW's errors as exceptions inside the block; elsewhere, GLFW's warnings must not stop a running player."""
    previous, glfw.ERROR_REPORTING = glfw.ERROR_REPORTING, "raise"
    try:
        yield
    finally:
        glfw.ERROR_REPORTING = previous


def _text(name: str | bytes) -> str:
    return name.decode(errors="replace") if isinstance(name, bytes) else name


def _plain(error: Exception) -> str:
    """Strip an error: `(65550) b'X11: The DISPLAY …'` -> `X11: The DISPLAY …`."""
    return str(error).partition(") ")[2].removeprefix("b").strip("'\"") or str(error)
