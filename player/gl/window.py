"""The player's window: a GLFW window with an OpenGL context (4.3, else 3.3), its keys, and the presenting pass."""

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import glfw
import moderngl

from counterlight.errors import AbsentError, InputError
from counterlight.gl.context import PACKAGES, window_context
from counterlight.gl.filling import Filling, Layer, take_keys
from counterlight.gl.monitor_labels import MonitorLabels
from counterlight.gl.monitors import (
    Monitor,
    after_a_change,
    bits_of_code,
    find_monitor,
    list_monitors,
    raising,
    start_glfw,
)
from counterlight.gl.mouse import Mouse
from counterlight.gl.presenter import Presenter
from counterlight.gl.x11 import Box
from counterlight.overlay.osd import Page, Pointer
from counterlight.raster import Region

REDRAW = "redraw"  # not a key: the window was resized or uncovered
CURSOR_S = 1.0  # seconds that a resting cursor stays visible in a window; in full screen it is always hidden
LABELS_S = 3.0
NAMED_KEYS = {
    glfw.KEY_SPACE: "space",
    glfw.KEY_ESCAPE: "escape",
    glfw.KEY_ENTER: "enter",
    glfw.KEY_KP_ENTER: "enter",
    glfw.KEY_TAB: "tab",
    glfw.KEY_BACKSPACE: "backspace",
    glfw.KEY_LEFT: "left",
    glfw.KEY_RIGHT: "right",
    glfw.KEY_UP: "up",
    glfw.KEY_DOWN: "down",
    glfw.KEY_PAGE_UP: "pageup",
    glfw.KEY_PAGE_DOWN: "pagedown",
    glfw.KEY_HOME: "home",
    glfw.KEY_END: "end",
}


class Window:
    """A window of the projector's size, or a filled monitor. It returns to its monitor after a reconnection.

    shape : (height, width) of the picture.
    monitor : monitor for full screen; None for the primary monitor.
    exact : refuse full screen at a size other than `shape`, because the correction is pixel by pixel.
    goal : name or number of the monitor that set_fullscreen fills before the window has been on any.
    sharing : a window whose textures this window can show.
    bits : bits per code value, 8 or 10; None for the monitor's setting. The attribute `bits` is the actual number.

    The creator releases the window. Raises InputError without a screen or OpenGL.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        title: str,
        *,
        monitor: Monitor | None,
        fullscreen: bool,
        exact: bool,
        vsync: bool,
        goal: str = "0",
        sharing: "Window | None" = None,
        bits: int | None = None,
    ) -> None:
        start_glfw()
        self._shape, self._vsync, self._goal = shape, vsync, goal
        self._home = None if monitor is None else monitor.name
        self._filling: Filling | None = None
        self._at_home = False
        self._keys: list[str] = []
        self._notices: list[str] = []
        self._labels: MonitorLabels | None = None
        self._monitors_changed = False
        self._cursor_moved_at = time.monotonic()
        if fullscreen and exact and monitor is not None:
            _check_size(shape, monitor)
        bits = bits or max((each.bits for each in ([monitor] if monitor else list_monitors()[:1])), default=8)
        self._handle: Any = _open(shape, title, bits, None if sharing is None else sharing._handle)
        try:
            self.context = window_context()
            self.bits = _bits_of(self.context)
            self._present = Presenter(self.context)
        except BaseException:
            self.release()
            raise
        glfw.set_key_callback(self._handle, self._on_key)
        glfw.set_char_callback(self._handle, self._on_character)
        glfw.set_cursor_pos_callback(self._handle, self._on_cursor)
        self._mouse = Mouse(self._handle, lambda key: self._keys.append(key), self._on_press)
        glfw.set_framebuffer_size_callback(self._handle, self._on_change)
        glfw.set_window_refresh_callback(self._handle, self._on_change)
        glfw.set_monitor_callback(self.on_monitor)
        self._windowed_at = (0, 0)
        if monitor is not None:
            glfw.set_window_pos(self._handle, monitor.x, monitor.y)
            self._at_home = True
        if fullscreen:
            self.set_fullscreen(True)
        else:
            glfw.show_window(self._handle)
            glfw.focus_window(self._handle)
            self._set_vsync()

    def attach(self, picture: Callable[[], moderngl.Texture], drive: Callable[[], bool] = lambda: True) -> None:
        """Set where the rendered view is found, because the renderer is made later, in the window's context.

        drive : whether the view is the projector's, pixel by pixel; other views grow with the window.
        """
        self._picture, self._drive = picture, drive

    @property
    def closed(self) -> bool:
        return bool(glfw.window_should_close(self._handle))

    @property
    def position(self) -> tuple[int, int]:
        """Upper left corner of the window's picture on the desktop: (x, y)."""
        x, y = glfw.get_window_pos(self._handle)
        return int(x), int(y)

    def place(self, x: int, y: int) -> None:
        """Move to a position on the desktop."""
        glfw.set_window_pos(self._handle, x, y)

    @property
    def visible(self) -> bool:
        return bool(glfw.get_window_attrib(self._handle, glfw.VISIBLE))

    @property
    def fullscreen(self) -> bool:
        return self._filling is not None

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in pixels."""
        width, height = glfw.get_framebuffer_size(self._handle)
        return int(height), int(width)

    @property
    def monitor(self) -> str:
        """Name of the monitor that the window fills, or that contains its middle."""
        monitors = list_monitors()
        (left, top), (width, height) = glfw.get_window_pos(self._handle), glfw.get_window_size(self._handle)
        x, y = left + width // 2, top + height // 2
        for monitor in monitors:
            if monitor.x <= x < monitor.x + monitor.width and monitor.y <= y < monitor.y + monitor.height:
                return monitor.name
        return monitors[0].name if monitors else "none"

    def poll(self, timeout_s: float) -> list[str]:
        """Return names of the keys pressed since the last call (player/show/keys.py), after at most `timeout_s`."""
        wait_for_events(timeout_s)
        return self.take_keys()

    def take_keys(self) -> list[str]:
        """Handle timers and monitor changes, then return the keys that have arrived."""
        if self._monitors_changed:
            with suppress(InputError):  # the server is changing its monitors: try again at the next call
                self._follow_monitor()
                self._monitors_changed = False
        if self._filling is not None and (complaint := self._filling.keep()) is not None:
            self._notices.append(complaint)
        if self._labels is not None and self._labels.over:
            self._remove_labels()
        if time.monotonic() - self._cursor_moved_at > CURSOR_S:
            self._show_cursor(False)
        keys, self._keys = self._keys, []
        return keys

    def notices(self) -> list[str]:
        """Return messages about the monitors since the last call."""
        fresh, self._notices = self._notices, []
        return fresh

    def present(self, page: Page | None, *, black: bool) -> None:
        """Show the attached picture, or black, with a page over it."""
        picture = None if black else self._picture()
        height, width = self._shape
        region = Region(0, 0, width, height) if picture is None else Region(0, 0, *picture.size)
        if self.draw(picture, region, page, grows=not self._drive()):
            self.swap()

    def pointers(self) -> list[Pointer]:
        """Return the left mouse button's actions since the last call."""
        return self._mouse.taken()

    def draw(self, picture: moderngl.Texture | None, region: Region, page: Page | None, *, grows: bool = False) -> bool:
        """Draw a part of a picture, or black for None. Returns False if the window is iconified.

        grows : whether the picture fills a larger window.

        The window must be current; `swap` then shows what was drawn.
        """
        size = glfw.get_framebuffer_size(self._handle)
        if 0 in size:
            return False
        self.context.screen.viewport = (0, 0, *size)
        self._mouse.shown = self._present.run(picture, region, size, page, grows=grows)
        return True

    def reload(self) -> None:
        """Recompile the presenting shader; a faulty shader raises an error and changes nothing."""
        self.make_current()
        self._present.reload()

    def swap(self) -> None:
        glfw.swap_buffers(self._handle)

    def make_current(self) -> None:
        """Draw into this window from now on."""
        glfw.make_context_current(self._handle)

    @property
    def wanted_monitor(self) -> Monitor:
        """The monitor to fill; raises InputError if it is missing."""
        return find_monitor(list_monitors(), self._goal if self._home is None else self._home)

    def set_title(self, title: str) -> None:
        glfw.set_window_title(self._handle, title)

    def set_fullscreen(self, on: bool) -> None:
        """Fill the monitor, or return to a window. The monitor's video mode is not changed."""
        if on and self._filling is None:
            monitor = self.wanted_monitor
            self._windowed_at = self.position
            self._home, self._at_home = monitor.name, True
            self._note_size(monitor)
            self._filling = Filling(self._handle, monitor, Layer.PICTURE)
            take_keys(self._handle)
        elif not on and self._filling is not None:
            height, width = self._shape
            self._filling.end(Box(*self._windowed_at, width, height))
            self._filling = None
        self._show_cursor(not on)
        self._set_vsync()  # some drivers lose the swap interval when the monitor changes

    def move_to(self, monitor: object) -> None:
        """Move to the monitor of a name or number; a window that fills a monitor then fills the new monitor."""
        wanted = find_monitor(list_monitors(), str(monitor))
        self._home, self._at_home = wanted.name, True
        if self._filling is None:
            self.place(wanted.x, wanted.y)
        else:
            self._note_size(wanted)
            self._filling.move(wanted)
            take_keys(self._handle)

    def identify(self) -> None:
        """Show number, name and size on every monitor for a few seconds."""
        self._remove_labels()
        self._labels = MonitorLabels(list_monitors(), LABELS_S)
        glfw.make_context_current(self._handle)

    def release(self) -> None:
        self._remove_labels()
        self.make_current()
        if hasattr(self, "_present"):
            self._present.release()
        if hasattr(self, "context"):
            self.context.release()
        glfw.destroy_window(self._handle)

    def _note_size(self, monitor: Monitor) -> None:
        if (monitor.height, monitor.width) != self._shape:
            found, needed = f"{monitor.width}x{monitor.height}", f"{self._shape[1]}x{self._shape[0]}"
            text = "the picture is centred, and its compensation does not fit"
            self._notices.append(f"the monitor is {found}, the projector {needed}: {text}")

    def _follow_monitor(self) -> None:
        """Move to the monitor's current place; report when the monitor is lost, and when the monitor is back."""
        monitors = list_monitors()
        act = after_a_change(self._home, monitors, at_home=self._at_home)
        if act == "left":
            self._at_home = False
            self._notices.append(f"monitor {self._home} has gone; its window waits until it is back")
        elif act == "return":
            self.move_to(self._home)
            self._notices.append(f"monitor {self._home} is back")
        if self._filling is not None:
            self._filling.follow(monitors)
        self._keys.append(REDRAW)

    def _set_vsync(self) -> None:
        """Set the swap interval; GLFW applies it to the current context."""
        current = glfw.get_current_context()
        glfw.make_context_current(self._handle)
        glfw.swap_interval(int(self._vsync))
        glfw.make_context_current(current)

    def _remove_labels(self) -> None:
        if self._labels is not None:
            self._labels.release()
            self._labels = None
            glfw.make_context_current(self._handle)

    def _show_cursor(self, on: bool) -> None:
        wanted = glfw.CURSOR_NORMAL if on and not self.fullscreen else glfw.CURSOR_HIDDEN
        if glfw.get_input_mode(self._handle, glfw.CURSOR) != wanted:
            glfw.set_input_mode(self._handle, glfw.CURSOR, wanted)

    def _on_change(self, *_: object) -> None:
        self._keys.append(REDRAW)

    def _on_press(self) -> None:
        """Handle a mouse press: take the keyboard focus, because no window manager gives it."""
        if self._filling is not None:
            take_keys(self._handle)

    def on_monitor(self, *_: object) -> None:
        """Note a monitor change. GLFW has one listener: the newest window, or the display that forwards the event."""
        self._monitors_changed = True

    def _on_cursor(self, *_: object) -> None:
        self._cursor_moved_at = time.monotonic()
        self._show_cursor(True)
        self._mouse.moved()

    def _on_character(self, _window: object, codepoint: int) -> None:
        if codepoint != ord(" "):  # a named key such as "left", not a character
            self._keys.append(chr(codepoint))

    def _on_key(self, _window: object, key: int, scancode: int, action: int, modifiers: int) -> None:
        """Handle named keys, and characters with ctrl. Plain characters arrive in _on_character, by keyboard layout."""
        if action not in (glfw.PRESS, glfw.REPEAT):
            return
        name = NAMED_KEYS.get(key)
        if modifiers & glfw.MOD_CONTROL:
            name = name or glfw.get_key_name(key, scancode)
            self._keys += [f"ctrl+{name}"] if name else []
        elif name is not None:
            self._keys.append(f"shift+{name}" if modifiers & glfw.MOD_SHIFT else name)


def wait_for_events(timeout_s: float) -> None:
    """Process events of all windows, waiting at most `timeout_s` for an event."""
    if timeout_s > 0:
        glfw.wait_events_timeout(timeout_s)
    else:
        glfw.poll_events()


def _open(shape: tuple[int, int], title: str, bits: int, sharing: Any) -> Any:
    try:
        return _open_with((4, 3), shape, title, bits, sharing)
    except InputError:
        return _open_with((3, 3), shape, title, bits, sharing)


def _open_with(version: tuple[int, int], shape: tuple[int, int], title: str, bits: int, sharing: Any) -> Any:
    height, width = shape
    hints = {
        glfw.CONTEXT_VERSION_MAJOR: version[0],
        glfw.CONTEXT_VERSION_MINOR: version[1],
        glfw.OPENGL_PROFILE: glfw.OPENGL_CORE_PROFILE,
        glfw.OPENGL_FORWARD_COMPAT: True,
        glfw.VISIBLE: False,  # the window is shown once it is in place
        glfw.AUTO_ICONIFY: False,  # a projector's window stays when another window gets the focus
        glfw.DEPTH_BITS: 0,
        glfw.STENCIL_BITS: 0,
        glfw.RED_BITS: bits,  # the driver chooses the nearest format
        glfw.GREEN_BITS: bits,
        glfw.BLUE_BITS: bits,
        glfw.ALPHA_BITS: 0 if bits > 8 else 8,
    }
    for hint, value in hints.items():
        glfw.window_hint(hint, value)
    with raising():
        try:
            handle = glfw.create_window(width, height, title, None, sharing)
        except glfw.GLFWError as error:
            raise _no_window(f" ({error})") from None
    if not handle:
        raise _no_window()
    glfw.make_context_current(handle)
    return handle


def _no_window(why: str = "") -> InputError:
    return InputError(
        f"no window with OpenGL 3.3{why}; install a driver: apt-get install {PACKAGES}, "
        "or ask counterlight doctor what is missing, or use --output FILE"
    )


def _bits_of(context: moderngl.Context) -> int:
    """Return the bits per code value of the context's screen: 8, or 10 if the window system provides them."""
    found: Mapping[str, int] = context.screen.bits  # type: ignore[assignment]
    context.error  # noqa: B018 - takes back what asking for parts that a screen lacks has left
    return bits_of_code(found[colour] for colour in ("red", "green", "blue"))


def _check_size(shape: tuple[int, int], monitor: Monitor) -> None:
    if (monitor.height, monitor.width) != shape:
        height, width = shape
        raise AbsentError(
            f"monitor {monitor.name}: {monitor.width}x{monitor.height}, the calibration is for a projector of "
            f"{width}x{height}; set its mode (xrandr --output {monitor.name} --mode {width}x{height}) or add --any-size"
        )
