"""Runs a player on an X server: its windows and their pixels, real key presses, monitors that appear and disappear."""

import contextlib
import subprocess
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from Xlib import XK, X
from Xlib.display import Display
from Xlib.error import BadDrawable, BadWindow
from Xlib.ext import xtest

from counterlight.pipeline.room import read_room
from tests.programs import PATIENCE_S, here, on, running, verb

Box = tuple[int, int, int, int]  # left, top, width, height


ON_A_GPU = "--shader", "fragment", "--entries", "16"  # options with which windows are drawn as files are, on a GPU
ON_THE_PROCESSOR = "--backend", "cpu"


def playing(
    display: str, *arguments: object, folder: Path | None = None, how: tuple[str, ...] = ON_A_GPU, **environment: str
) -> AbstractContextManager[subprocess.Popen[str]]:
    """Start a player in a window that is drawn like a file, so that pixels can be compared exactly."""
    return running(*verb("play"), *how, *arguments, folder=folder, **on(display), **environment)


def expected_picture(
    room: Path, medium: Path, tmp_path: Path, *options: str, how: tuple[str, ...] = ON_A_GPU
) -> np.ndarray:
    """Render the same view headless, RGB, with a window's number of steps for a still picture."""
    if "--refine" not in options:
        options = *options, "--refine", str(read_room(room, None).default_steps)
    here("play", room, medium, *how, "--output", tmp_path / "expected.png", *options)
    return cv2.imread(str(tmp_path / "expected.png"))[..., ::-1].astype(int)


def screen(display: str, box: Box) -> np.ndarray:
    """Pixels that the X server shows in a box, RGB."""
    packed, depth = _grabbed(display, box)
    assert depth == 24
    return packed.view(np.uint8).reshape(*packed.shape, 4)[..., 2::-1].astype(int)


def fine_screen(display: str, box: Box) -> np.ndarray:
    """Pixels of a screen of depth 30 in a box, as 10-bit codes."""
    packed, depth = _grabbed(display, box)
    assert depth == 30
    return (packed[..., None] >> np.uint32([20, 10, 0]) & 1023).astype(int)


def _grabbed(display: str, box: Box) -> tuple[NDArray[np.uint32], int]:
    """Pixels of the part of a box on the screen, (height, width), as the X server packs them, and their depth in bits.

    A screen may end within the box, and ends before it while the box's monitor is off.
    """
    left, top, width, height = box
    with contextlib.closing(Display(display)) as connection:
        connection.grab_server()  # the screen keeps its size until the connection is closed
        root = connection.screen().root
        whole = root.get_geometry()
        width, height = min(width, whole.width - left), min(height, whole.height - top)
        if width <= 0 or height <= 0:
            return np.zeros((0, 0), np.uint32), whole.depth
        found = root.get_image(left, top, width, height, X.ZPixmap, 0xFFFFFFFF)
    return np.frombuffer(found.data, "<u4").reshape(height, width), whole.depth


def mapped_windows(display: str) -> set[Box]:
    """Boxes of the visible windows of a desktop without a window manager."""
    return {(each.x, each.y, each.width, each.height) for each in _visible(display)}


def window_depths(display: str) -> set[int]:
    """Bits per pixel of the visible windows."""
    return {each.depth for each in _visible(display)}


def title_that_gets_keys(display: str) -> str:
    """Title of the window with the input focus; empty if no window has it."""
    with contextlib.closing(Display(display)) as connection:
        found = connection.get_input_focus().focus
        with contextlib.suppress(BadWindow):  # the window was closed meanwhile
            return "" if found in (X.NONE, X.PointerRoot) else found.get_wm_name() or ""
    return ""


def _visible(display: str) -> list[Any]:
    connection = Display(display)
    found = []
    for window in connection.screen().root.query_tree().children:
        with contextlib.suppress(BadDrawable, BadWindow):  # the window was closed meanwhile
            if window.get_attributes().map_state == X.IsViewable:
                found.append(window.get_geometry())
    connection.close()
    return found


def press(display: str, key: str, *held: str) -> None:
    """Press and release a real key through the X server, with shift if the symbol needs it."""
    connection = Display(display)
    symbol = XK.string_to_keysym(key)
    code = connection.keysym_to_keycode(symbol)
    shift = [] if connection.keycode_to_keysym(code, 0) == symbol else ["Shift_L"]
    modifiers = [connection.keysym_to_keycode(XK.string_to_keysym(name)) for name in (*held, *shift)]
    for pressed in (*modifiers, code):
        xtest.fake_input(connection, X.KeyPress, pressed)
    for released in (code, *reversed(modifiers)):
        xtest.fake_input(connection, X.KeyRelease, released)
    connection.sync()
    connection.close()


def mouse(display: str, *events: tuple[str, int, int]) -> None:
    """Send real mouse events through the X server: ("move", x, y), or ("press" or "release", button, 0)."""
    connection = Display(display)
    for action, first, second in events:
        if action == "move":
            xtest.fake_input(connection, X.MotionNotify, x=first, y=second)
        else:
            xtest.fake_input(connection, X.ButtonPress if action == "press" else X.ButtonRelease, first)
        connection.sync()
    connection.close()


def click(display: str, button: int, count: int = 1, *, held: tuple[str, ...] = ()) -> None:
    """Click a mouse button while keys are held."""
    with contextlib.closing(Display(display)) as connection:
        codes = [connection.keysym_to_keycode(XK.string_to_keysym(name)) for name in held]
        for code in codes:
            xtest.fake_input(connection, X.KeyPress, code)
        connection.sync()
        mouse(display, ("move", 12, 9), *[("press", button, 0), ("release", button, 0)] * count)
        for code in codes:
            xtest.fake_input(connection, X.KeyRelease, code)
        connection.sync()


def xrandr(display: str, *arguments: str) -> None:
    subprocess.run(["xrandr", "--display", display, *arguments], check=True, capture_output=True, timeout=PATIENCE_S)
