"""When the X server goes: Xlib then ends the process whatever we do, so we do it, with one line and an exit code."""

import ctypes
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from counterlight.command import BAD_INPUT, tell

_farewells: list[Callable[[], object]] = []


@contextmanager
def farewell(act: Callable[[], object]) -> Iterator[None]:
    """Have something done before the process ends since its screen has gone; it must not need the screen."""
    _farewells.append(act)
    try:
        yield
    finally:
        _farewells.remove(act)


def watch() -> None:
    """Have the loss of the X server told in one line; nothing where there is no Xlib."""
    with suppress(OSError):
        ctypes.CDLL("libX11.so.6").XSetIOErrorHandler(_on_loss)


def _lost(_display: int) -> int:
    """Must not return (XSetIOErrorHandler(3)); an exception would be lost on its way through Xlib."""
    for act in reversed(_farewells):
        with suppress(Exception):
            act()
    tell("error: the screen has gone, the X server ended; start again when it is back", patience_s=1.0)
    os._exit(BAD_INPUT)


_on_loss = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)(_lost)  # Xlib holds it for as long as the process lives
