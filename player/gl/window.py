"""The player's window: a GLFW window with an OpenGL 3.3 context, its keys, and the pass that presents a picture."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import glfw
import moderngl
import numpy as np
from numpy.typing import NDArray

from player.errors import InputError
from player.gl.monitors import Monitor, monitor_handle, raising, start_glfw
from player.gl.passes import ScreenPass

OVERLAY_SHAPE = (240, 720)
REDRAW = "redraw"  # not a key: the window was resized or uncovered
LINE_HEIGHT, MARGIN, GROUND_ALPHA = 22, 8, 170
NAMED_KEYS = {
    glfw.KEY_SPACE: "space",
    glfw.KEY_ESCAPE: "escape",
    glfw.KEY_LEFT: "left",
    glfw.KEY_RIGHT: "right",
    glfw.KEY_UP: "up",
    glfw.KEY_DOWN: "down",
}


class Window:
    """A window of the projector's size, or a monitor filled.

    shape : (height, width) of the picture that is shown.  monitor : where to go full screen; None for the primary one.
    exact : refuse a full screen whose size is not `shape`, since the correction is pixel by pixel.
    """

    def __init__(
        self, shape: tuple[int, int], title: str, *, monitor: Monitor | None, fullscreen: bool, exact: bool, vsync: bool
    ) -> None:
        start_glfw()
        self._shape, self._monitor, self._vsync = shape, monitor, vsync
        self._keys: list[str] = []
        if fullscreen and exact and monitor is not None:
            _check_size(shape, monitor)
        self._handle = _open(shape, title)
        try:
            self.context = moderngl.create_context(require=330)
            self._present = _Presenter(self.context, shape)
        except BaseException:
            self.release()
            raise
        glfw.set_key_callback(self._handle, self._on_key)
        glfw.set_framebuffer_size_callback(self._handle, self._on_change)
        glfw.set_window_refresh_callback(self._handle, self._on_change)
        self._windowed_at = (0, 0)
        if monitor is not None:
            glfw.set_window_pos(self._handle, monitor.x, monitor.y)
        if fullscreen:
            self.toggle_fullscreen()
        glfw.show_window(self._handle)
        glfw.swap_interval(int(vsync))

    def attach(self, picture: Callable[[], moderngl.Texture]) -> None:
        """Say where the rendered view is found; the renderer is made after the window, in its context."""
        self._picture = picture

    @property
    def closed(self) -> bool:
        return bool(glfw.window_should_close(self._handle))

    @property
    def fullscreen(self) -> bool:
        return bool(glfw.get_window_monitor(self._handle))

    def poll(self, timeout_s: float) -> list[str]:
        """Names of the keys pressed since the last call, waiting at most `timeout_s` for an event."""
        if timeout_s > 0:
            glfw.wait_events_timeout(timeout_s)
        else:
            glfw.poll_events()
        keys, self._keys = self._keys, []
        return keys

    def present(self, lines: list[str], *, black: bool) -> None:
        """Show the attached picture, or black, with lines of text over it."""
        size = glfw.get_framebuffer_size(self._handle)
        self.context.screen.viewport = (0, 0, *size)
        self._present.run(self._picture(), size, lines, black=black)
        glfw.swap_buffers(self._handle)

    def toggle_fullscreen(self) -> None:
        """Fill the monitor, or go back to a window. The video mode of the monitor is left as it is."""
        if self.fullscreen:
            height, width = self._shape
            nowhere: Any = None
            glfw.set_window_monitor(self._handle, nowhere, *self._windowed_at, width, height, glfw.DONT_CARE)
            glfw.set_input_mode(self._handle, glfw.CURSOR, glfw.CURSOR_NORMAL)
        else:
            self._windowed_at = glfw.get_window_pos(self._handle)
            handle = glfw.get_primary_monitor() if self._monitor is None else monitor_handle(self._monitor)
            mode = glfw.get_video_mode(handle)
            if (mode.size.height, mode.size.width) != self._shape:
                found, needed = f"{mode.size.width}x{mode.size.height}", f"{self._shape[1]}x{self._shape[0]}"
                print(f"the monitor is {found}, the projector {needed}: centred, so not corrected", file=sys.stderr)
            glfw.set_window_monitor(self._handle, handle, 0, 0, *mode.size, mode.refresh_rate)
            glfw.set_input_mode(self._handle, glfw.CURSOR, glfw.CURSOR_HIDDEN)
        glfw.swap_interval(int(self._vsync))  # some drivers forget it with the change

    def release(self) -> None:
        if hasattr(self, "_present"):
            self._present.release()
        if hasattr(self, "context"):
            self.context.release()
        glfw.destroy_window(self._handle)

    def _on_change(self, *_: object) -> None:
        self._keys.append(REDRAW)

    def _on_key(self, _window: object, key: int, _scancode: int, action: int, _modifiers: int) -> None:
        if action not in (glfw.PRESS, glfw.REPEAT):
            return
        name = NAMED_KEYS.get(key) or glfw.get_key_name(key, 0)
        if name:
            self._keys.append(name)


@contextmanager
def open_window(
    shape: tuple[int, int], title: str, *, monitor: Monitor | None, fullscreen: bool, exact: bool, vsync: bool = True
) -> Iterator[Window]:
    """A window that is closed, and its context released, at the end. Raises InputError without a screen or OpenGL."""
    window = Window(shape, title, monitor=monitor, fullscreen=fullscreen, exact=exact, vsync=vsync)
    try:
        yield window
    finally:
        window.release()


class _Presenter:
    """The present pass and its overlay texture."""

    def __init__(self, context: moderngl.Context, shape: tuple[int, int]) -> None:
        height, width = OVERLAY_SHAPE
        self._overlay = context.texture((width, height), 4, dtype="f1")
        self._no_overlay = context.texture((1, 1), 4, bytes(4), dtype="f1")
        self._black = context.texture((1, 1), 4, bytes(4), dtype="f1")
        self._pass = ScreenPass(context, "present.frag")
        self._context, self._shape = context, shape
        self._shown: list[str] = []

    def run(self, picture: moderngl.Texture, size: tuple[int, int], lines: list[str], *, black: bool) -> None:
        if lines and lines != self._shown:
            self._overlay.write(draw_text(lines, OVERLAY_SHAPE))
            self._shown = list(lines)
        self._context.screen.use()
        self._pass.set(window_size=size, place=_centred((picture.height, picture.width), size))
        self._pass.draw(picture=self._black if black else picture, overlay=self._overlay if lines else self._no_overlay)

    def release(self) -> None:
        for resource in (self._pass, self._overlay, self._no_overlay, self._black):
            resource.release()


def draw_text(lines: list[str], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """White lines on a dark, half transparent ground, (height, width, RGBA); the ground is as high as the text."""
    ink = np.zeros(shape, np.uint8)
    for row, line in enumerate(lines):
        at = MARGIN, MARGIN + LINE_HEIGHT * row + 16
        cv2.putText(ink, line, at, cv2.FONT_HERSHEY_SIMPLEX, 0.55, (255,), 1, cv2.LINE_AA)
    ground = np.zeros(shape, np.uint8)
    ground[: LINE_HEIGHT * len(lines) + 2 * MARGIN] = GROUND_ALPHA
    return np.dstack([ink, ink, ink, np.maximum(ink, ground)])


def _open(shape: tuple[int, int], title: str) -> Any:
    height, width = shape
    hints = {
        glfw.CONTEXT_VERSION_MAJOR: 3,
        glfw.CONTEXT_VERSION_MINOR: 3,
        glfw.OPENGL_PROFILE: glfw.OPENGL_CORE_PROFILE,
        glfw.OPENGL_FORWARD_COMPAT: True,
        glfw.VISIBLE: False,  # until it stands where it belongs
        glfw.AUTO_ICONIFY: False,  # a projector's window stays when another gets the focus
        glfw.DEPTH_BITS: 0,
        glfw.STENCIL_BITS: 0,
    }
    for hint, value in hints.items():
        glfw.window_hint(hint, value)
    with raising():
        try:
            handle = glfw.create_window(width, height, title, None, None)
        except glfw.GLFWError as error:
            raise InputError(f"no window with OpenGL 3.3 ({error}); install a driver: apt-get install libgl1") from None
    if not handle:
        raise InputError("no window with OpenGL 3.3; install a driver: apt-get install libgl1, or use --output FILE")
    glfw.make_context_current(handle)
    return handle


def _centred(shape: tuple[int, int], window: tuple[int, int]) -> tuple[int, int, int, int]:
    """(left, top, width, height): pixel for pixel and centred if the window is large enough, else shrunk to fit."""
    height, width = shape
    scale = min(1.0, window[0] / width, window[1] / height)
    shown = max(1, round(width * scale)), max(1, round(height * scale))
    return (window[0] - shown[0]) // 2, (window[1] - shown[1]) // 2, *shown


def _check_size(shape: tuple[int, int], monitor: Monitor) -> None:
    if (monitor.height, monitor.width) != shape:
        height, width = shape
        raise InputError(
            f"monitor {monitor.name}: {monitor.width}x{monitor.height}, the calibration is for a projector of "
            f"{width}x{height}; set its mode (xrandr --output {monitor.name} --mode {width}x{height}) or add --any-size"
        )
