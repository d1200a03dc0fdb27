"""The audience never sees a desktop: whole evenings under three window managers, and without one."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest
from Xlib.display import Display
from Xlib.error import BadWindow

from counterlight.unattended.supervisor import MOST_CRASHES
from tests.audience import (
    ALWAYS,
    BOX,
    CURTAIN,
    LEVELS,
    MANAGERS,
    PLAYER,
    SILENT,
    Audience,
    Evening,
    change,
    closed_hours,
    managed,
    runs,
    theatre,
    write_film,
    write_films,
    write_room,
)
from tests.desktop import mouse, press, xrandr
from tests.programs import PATIENCE_S, children, descendants, here, is_running, on, running, verb, wait_until
from tests.remote import Client

DARK, BRIGHT = LEVELS
FRAMES = 15  # frames per level


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Write two flat films, and a film of 24 seconds that alternates, because each medium starts a decoder."""
    folder = tmp_path_factory.mktemp("films")
    both = [level for level in LEVELS.values() for _ in range(FRAMES)]
    return [*write_films(folder, FRAMES), write_film(folder / "both.mkv", 20 * both)]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory, films: list[Path]) -> Path:
    folder = tmp_path_factory.mktemp("audience") / "wall"
    write_room(folder)
    here("build", folder, "--no-refine")
    here("play", folder, films[0], "--output", folder.with_name("first.png"))  # compiles code before the timed shows
    return folder


@pytest.mark.parametrize("manager", MANAGERS)
def test_the_audience_sees_black_or_the_picture(manager: str, room: Path, films: list[Path], tmp_path: Path) -> None:
    hours, control = tmp_path / "hours.toml", tmp_path / "socket"
    change(hours, closed_hours())
    how = "--supervise", "--loop", "--control", control, "--schedule", hours
    with (
        theatre(tmp_path, manager) as display,
        Audience(display, tmp_path, composited=manager == "metacity") as audience,
    ):
        with running(*verb("play"), room, *films, "--fullscreen", *SILENT, *how, **on(display)) as process:
            evening = Evening(process, audience)
            evening.sees("black")  # outside the hours of the show
            change(hours, ALWAYS)
            evening.sees(DARK, BRIGHT, DARK)  # the show begins, then media change

            curtain, before = evening.child(CURTAIN), len(audience.seen)
            os.kill(curtain, signal.SIGKILL)
            evening.child(CURTAIN, other_than=curtain)
            evening.sees(BRIGHT, DARK, BRIGHT, DARK)  # the next curtain begins behind the show
            assert "black" not in audience.seen[before:]

            first = evening.child(PLAYER)
            (decoder, *_) = descendants(first)
            os.kill(decoder, signal.SIGSEGV)
            evening.sees(BRIGHT, DARK)  # after the death of the decoder
            with Client(control) as client:
                assert client.ask("reload")["error"] == "success"
            evening.sees(BRIGHT, DARK)  # after the room was rebuilt

            xrandr(display, "--output", "DUMMY1", "--off")
            evening.sees("")
            xrandr(display, "--output", "DUMMY1", "--mode", "256x192", "--pos", "1280x0")
            evening.sees(BRIGHT, DARK)

            os.kill(first, signal.SIGSEGV)
            evening.sees("black", BRIGHT)  # after a crash
            last = second = evening.child(PLAYER, other_than=first)
            for pid in (second, *descendants(second)):
                os.kill(pid, signal.SIGSTOP)
            wait_until(lambda: not is_running(second), "what hangs is ended", process)
            for _ in range(MOST_CRASHES - 2):
                last = evening.child(PLAYER, other_than=last)
                os.kill(last, signal.SIGKILL)
            evening.sees("black")
            wait_until(lambda: not any(runs(pid, PLAYER) for pid in children(process.pid)), "the safe picture", process)
            process.send_signal(signal.SIGHUP)
            evening.sees(BRIGHT, DARK)  # after a new attempt
            process.terminate()
            assert process.wait(PATIENCE_S) == 130
        audience.leaves()
    assert audience.leaks == []
    assert audience.seen[:2] == ["desktop", "black"]
    assert audience.seen.index("desktop", 1) == len(audience.seen) - 1  # only black and the picture before the desktop


def test_a_window_manager_that_dies_and_another_that_begins(room: Path, films: list[Path], tmp_path: Path) -> None:
    """GLFW would fail an assertion after the window manager dies.

    A new window that covers the projector is covered in turn.
    """
    options = "--fullscreen", *SILENT, "--osd", "off", "--loop"
    with theatre(tmp_path, "none") as display:
        with managed(display, tmp_path, "icewm"):
            pass
        show = running(*verb("play"), room, *films, *options, **on(display))
        with Audience(display, tmp_path) as audience, show as process:
            evening = Evening(process, audience)
            evening.sees("black", DARK, BRIGHT)
            with managed(display, tmp_path, "openbox"):
                evening.sees(DARK, BRIGHT)
                assert audience.leaks == []
                assert audience.seen.count("desktop") == 1
                with stranger(display) as is_covered:
                    wait_until(is_covered, "the picture above the stranger", process)
                mouse(display, ("move", BOX[0] + 9, 9), ("press", 1, 0), ("release", 1, 0))
                wait_until(lambda: has_keyboard(display), "the keyboard", process)
                press(display, "q")
                _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert errors.splitlines()[0] == "the window manager has died; going on without one"


def test_full_screen_and_back_under_a_window_manager(room: Path, films: list[Path], tmp_path: Path) -> None:
    """The keys are pressed in a window. Afterwards the manager decorates the window again."""
    options = "--monitor", "DUMMY1", *SILENT, "--osd", "off", "--loop"
    with (
        theatre(tmp_path, "openbox") as display,
        Audience(display, tmp_path) as audience,
        running(*verb("play"), room, *films, *options, **on(display)) as process,
    ):
        evening = Evening(process, audience)
        evening.sees("leak")
        wait_until(lambda: has_keyboard(display), "the keyboard", process)
        press(display, "f")
        evening.sees(DARK, BRIGHT)
        before = len(audience.leaks)
        evening.sees(DARK, BRIGHT)
        assert len(audience.leaks) == before
        press(display, "Escape")
        evening.sees("leak")
        wait_until(lambda: has_keyboard(display), "the keyboard", process)
        press(display, "q")
        assert process.wait(PATIENCE_S) == 0


def has_keyboard(display: str) -> bool:
    """Return whether a player's window has the keyboard."""
    # there is no such window, or it has just closed
    with closing(Display(display)) as connection, suppress(AttributeError, BadWindow):
        return "Counterlight" in (connection.get_input_focus().focus.get_wm_class() or ())
    return False


@contextmanager
def stranger(display: str) -> Iterator[Callable[[], bool]]:
    """Open another program's unmanaged white window on the projector; yield whether a window covers it."""
    with closing(Display(display)) as connection:
        screen = connection.screen()
        window = screen.root.create_window(
            BOX[0] + 20, 20, 50, 50, 0, screen.root_depth, background_pixel=screen.white_pixel, override_redirect=True
        )
        window.map()
        connection.sync()
        yield lambda: screen.root.query_tree().children[-1] != window
