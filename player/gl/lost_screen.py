"""Loss of the X server: Xlib would end the process anyway, so this module ends it first, with one line."""

import ctypes
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from counterlight.command import BAD_INPUT, tell

_farewells: list[Callable[[], object]] = []


@contextmanager
def farewell(act: Callable[[], object]) -> Iterator[None]:
    """Register an action to run before the process ends because its screen is lost; it must not need the screen."""
    _farewells.append(act)
    try:
        yield
    finally:
        _farewells.remove(act)


def watch() -> None:
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
