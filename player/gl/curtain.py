"""python -m counterlight.gl.curtain [MONITOR…]: fills monitors with black, below a show and between shows.

Needs no calibration, shader or OpenGL, and sends heartbeats like the player. It waits for a missing monitor.
"""

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import glfw

from counterlight.command import run, tell
from counterlight.errors import InputError
from counterlight.gl.filling import CHECK_S, Filling, Layer
from counterlight.gl.monitors import Monitor, find_monitor, list_monitors, raising
from counterlight.unattended.heartbeat import Heartbeat, Notifier

HINTS = {
    glfw.CLIENT_API: glfw.NO_API,
    glfw.VISIBLE: False,
    glfw.DECORATED: False,
    glfw.FOCUS_ON_SHOW: False,
    glfw.AUTO_ICONIFY: False,
}


class Curtain:
    """Black on the monitor of a name or number, as soon as that monitor is connected."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._filling: Filling | None = None

    def follow(self, monitors: Sequence[Monitor]) -> str | None:
        """Move to the monitor's current place. monitors : the connected ones. Returns a complaint, once per problem."""
        if self._filling is None:
            with suppress(InputError):  # the monitor may be connected later
                monitor = find_monitor(monitors, self._name)
                self._filling = Filling(_window(monitor), monitor, Layer.CURTAIN)
            return None
        self._filling.follow(monitors)
        return self._filling.keep()


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    names = list(sys.argv[1:] if argv is None else argv)
    monitors = list_monitors()
    curtains = [Curtain(name) for name in names or ["0"]]
    heartbeat = Heartbeat(None, Notifier(os.environ.get("NOTIFY_SOCKET")))
    try:
        while True:
            with suppress(InputError):  # the server is changing its monitors: try again soon
                monitors = list_monitors()
            for curtain in curtains:
                complaint = curtain.follow(monitors)
                if complaint is not None:
                    tell(complaint)
            heartbeat.beat({})
            glfw.wait_events_timeout(CHECK_S)
    finally:
        heartbeat.close()
        glfw.terminate()


def _window(monitor: Monitor) -> Any:
    for hint, value in HINTS.items():
        glfw.window_hint(hint, value)
    with raising():
        try:
            window = glfw.create_window(monitor.width, monitor.height, "curtain - Counterlight", None, None)
        except glfw.GLFWError as error:
            raise InputError(f"monitor {monitor.name}: no black window ({error}); try again") from None
    glfw.set_input_mode(window, glfw.CURSOR, glfw.CURSOR_HIDDEN)
    return window


if __name__ == "__main__":
    sys.exit(main())
