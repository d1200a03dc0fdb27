"""Labels with number, name and size on every monitor: small windows without focus that close by themselves."""

import time
from collections.abc import Sequence
from typing import Any

import glfw
import moderngl

from counterlight.gl.context import window_context
from counterlight.gl.filling import Layer, detach, put
from counterlight.gl.monitors import Monitor
from counterlight.gl.passes import ScreenPass, Uniform
from counterlight.gl.x11 import Box
from counterlight.overlay.osd import Page, draw

LETTERS = (2160, 3840)  # size letters as for a window of (height, width), so that they are readable across a room
HINTS = {
    glfw.FLOATING: True,
    glfw.FOCUSED: False,
    glfw.FOCUS_ON_SHOW: False,
    glfw.MOUSE_PASSTHROUGH: True,
    glfw.RESIZABLE: False,
    glfw.VISIBLE: False,
}


class MonitorLabels:
    """Opens labels at creation; release them when `over`. Another context is current afterwards."""

    def __init__(self, monitors: Sequence[Monitor], seconds: float) -> None:
        self._until = time.monotonic() + seconds
        self._windows: list[Any] = []
        for monitor in monitors:
            self._open(monitor)

    @property
    def over(self) -> bool:
        return time.monotonic() >= self._until

    def release(self) -> None:
        for window in self._windows:
            glfw.destroy_window(window)
        self._windows = []

    def _open(self, monitor: Monitor) -> None:
        """Open a window in the middle of a monitor and draw it once. On failure, the monitor has no label."""
        pixels = draw(Page((f"{monitor.index}  {monitor.name}", f"{monitor.width}x{monitor.height}")), LETTERS)
        height, width = min(pixels.shape[0], monitor.height), min(pixels.shape[1], monitor.width)
        for hint, value in HINTS.items():
            glfw.window_hint(hint, value)
        window = glfw.create_window(width, height, monitor.name, None, None)
        if not window:
            return
        self._windows.append(window)
        x, y = monitor.x + (monitor.width - width) // 2, monitor.y + (monitor.height - height) // 2
        detach(window, Layer.LABEL)
        put(window, Box(x, y, width, height))
        glfw.make_context_current(window)
        _paint(window_context(), pixels.tobytes(), pixels.shape[1::-1], (width, height))
        glfw.swap_buffers(window)


def _paint(context: moderngl.Context, rgba: bytes, size: tuple[int, ...], window: tuple[int, int]) -> None:
    texture = context.texture((size[0], size[1]), 4, rgba, dtype="f1")
    black = context.texture((1, 1), 4, bytes(4), dtype="f1")
    uniforms: dict[str, Uniform] = {"window_size": window, "region": (0, 0, 1, 1), "place": (0, 0, *window)}
    shown = ScreenPass(context, "present.frag", uniforms=uniforms)
    context.screen.viewport = (0, 0, *window)
    context.screen.use()
    shown.draw(picture=black, overlay=texture)
    context.finish()
    for resource in (shown, texture, black, context):
        resource.release()
