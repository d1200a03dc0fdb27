"""python -m counterlight.gl.black [MONITOR…]: monitors filled with black, the safe picture when the player cannot run.

Needs neither a calibration nor a shader, and beats like the player.
"""

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import glfw
import moderngl

from counterlight.command import run
from counterlight.errors import InputError
from counterlight.gl.monitors import Monitor, find_monitor, list_monitors, monitor_handle
from counterlight.unattended.heartbeat import INTERVAL_S, Heartbeat, Notifier


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    arguments = list(sys.argv[1:] if argv is None else argv)
    monitors = list_monitors()
    glfw.window_hint(glfw.AUTO_ICONIFY, False)
    windows = [_open(monitor) for monitor in _chosen(monitors, arguments or ["0"])]
    heartbeat = Heartbeat(None, Notifier(os.environ.get("NOTIFY_SOCKET")))
    try:
        while not any(glfw.window_should_close(window) for window, _ in windows):
            for window, context in windows:
                glfw.make_context_current(window)
                context.clear()
                glfw.swap_buffers(window)
            heartbeat.beat({})
            glfw.wait_events_timeout(0.5 * INTERVAL_S)
    finally:
        heartbeat.close()
        for window, context in windows:
            glfw.make_context_current(window)
            context.release()
            glfw.destroy_window(window)


def _chosen(monitors: Sequence[Monitor], names: Sequence[str]) -> list[Monitor]:
    """Those of the names that are there, or else the first: black somewhere is better than none."""
    chosen = []
    for name in names:
        with suppress(InputError):  # unplugged, say
            chosen.append(find_monitor(monitors, name))
    return chosen or [find_monitor(monitors, 0)]


def _open(monitor: Monitor) -> tuple[Any, moderngl.Context]:
    size = monitor.width, monitor.height
    window = glfw.create_window(*size, "black - Counterlight", monitor_handle(monitor), None)
    if not window:
        raise InputError("no window for a black picture; install a driver: apt-get install libgl1")
    glfw.make_context_current(window)
    glfw.set_input_mode(window, glfw.CURSOR, glfw.CURSOR_HIDDEN)
    return window, moderngl.create_context()


if __name__ == "__main__":
    sys.exit(main())
