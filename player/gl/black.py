"""python -m player.gl.black [MONITOR]: a monitor filled with black, the safe picture when the player cannot run.

Needs neither a calibration nor a shader, and beats like the player.
"""

import os
import sys
from collections.abc import Sequence

import glfw
import moderngl

from player.command import run
from player.errors import InputError
from player.gl.monitors import find_monitor, list_monitors, monitor_handle
from player.heartbeat import INTERVAL_S, Heartbeat, Notifier


def main(argv: Sequence[str] | None = None) -> int:
    return run(_main, argv)


def _main(argv: Sequence[str] | None) -> None:
    arguments = list(sys.argv[1:] if argv is None else argv)
    monitors = list_monitors()
    try:
        monitor = find_monitor(monitors, arguments[0] if arguments else 0)
    except InputError:  # unplugged, say: black somewhere is better than none
        monitor = find_monitor(monitors, 0)
    glfw.window_hint(glfw.AUTO_ICONIFY, False)
    size = monitor.width, monitor.height
    window = glfw.create_window(*size, "black - Counterlight", monitor_handle(monitor), None)
    if not window:
        raise InputError("no window for a black picture; install a driver: apt-get install libgl1")
    glfw.make_context_current(window)
    glfw.set_input_mode(window, glfw.CURSOR, glfw.CURSOR_HIDDEN)
    context = moderngl.create_context()
    heartbeat = Heartbeat(None, Notifier(os.environ.get("NOTIFY_SOCKET")))
    try:
        while not glfw.window_should_close(window):
            context.clear()
            glfw.swap_buffers(window)
            heartbeat.beat({})
            glfw.wait_events_timeout(0.5 * INTERVAL_S)
    finally:
        heartbeat.close()
        context.release()
        glfw.destroy_window(window)


if __name__ == "__main__":
    sys.exit(main())
