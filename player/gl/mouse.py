"""The mouse in a window: actions of the left button over the picture; double clicks and wheel steps as keys.

The key name starts with `ctrl+` while Ctrl is held (player/show/keys.py).
"""

import time
from collections.abc import Callable
from typing import Any, Literal

import glfw

from counterlight.gl.presenter import Shown
from counterlight.overlay.osd import Pointer

DOUBLE_CLICK_S, DOUBLE_CLICK_PIXELS = 0.4, 8  # largest time and distance between the presses of a double click


class Mouse:
    """Reports mouse actions in a window.

    key : called with a key name for every double click and wheel step (player/show/keys.py).
    press : called for every press of a button.
    """

    def __init__(self, handle: Any, key: Callable[[str], None], press: Callable[[], None]) -> None:
        self._handle, self._key, self._press = handle, key, press
        self._pointers: list[Pointer] = []
        self._pressed = False
        self._clicked: tuple[float, tuple[float, float]] = float("-inf"), (0.0, 0.0)
        self.shown: Shown | None = None  # position of the picture in the window
        glfw.set_mouse_button_callback(handle, self._on_button)
        glfw.set_scroll_callback(handle, self._on_scroll)

    def taken(self) -> list[Pointer]:
        """Return the left button's actions since the last call."""
        fresh, self._pointers = self._pointers, []
        return fresh

    def moved(self) -> None:
        if self._pressed:
            self._point("move")

    def _on_button(self, _window: object, button: int, action: int, _modifiers: int) -> None:
        if action == glfw.PRESS:
            self._press()
        if button != glfw.MOUSE_BUTTON_LEFT:
            return
        self._pressed = action == glfw.PRESS
        self._point("press" if self._pressed else "release")
        if self._pressed:
            self._count_click()

    def _count_click(self) -> None:
        (before_s, there), now_s, here = self._clicked, time.monotonic(), glfw.get_cursor_pos(self._handle)
        near = max(abs(here[0] - there[0]), abs(here[1] - there[1])) <= DOUBLE_CLICK_PIXELS
        if near and now_s - before_s <= DOUBLE_CLICK_S:
            self._key(self._with_ctrl("double-click"))
            now_s = float("-inf")  # a third click is the first of a new pair
        self._clicked = now_s, here

    def _on_scroll(self, _window: object, left: float, up: float) -> None:
        """Send a key per wheel step. Touch pads send fractions of a step; each fraction counts as a step."""
        for amount, names in ((left, ("wheel-right", "wheel-left")), (up, ("wheel-down", "wheel-up"))):
            for _ in range(max(round(abs(amount)), 1) if amount else 0):
                self._key(self._with_ctrl(names[amount > 0]))

    def _with_ctrl(self, name: str) -> str:
        keys = glfw.KEY_LEFT_CONTROL, glfw.KEY_RIGHT_CONTROL
        held = any(glfw.get_key(self._handle, key) == glfw.PRESS for key in keys)
        return f"ctrl+{name}" if held else name

    def _point(self, action: Literal["press", "move", "release"]) -> None:
        width, height = glfw.get_window_size(self._handle)
        if self.shown is None or 0 in (width, height):
            return
        x, y = glfw.get_cursor_pos(self._handle)
        pixels = glfw.get_framebuffer_size(self._handle)
        self._pointers.append(Pointer(action, *self.shown.share(x * pixels[0] / width, y * pixels[1] / height)))
