"""A window that fills a monitor stays there despite other changes, tested with a curtain, which needs no OpenGL."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from Xlib.display import Display

from tests.desktop import mapped_windows, xrandr
from tests.programs import PATIENCE_S, ROOT, fail, on, running, wait_until

DESK, PROJECTOR = (0, 0, 1280, 720), (1280, 0, 1024, 768)


@pytest.fixture
def curtain(two_monitors: str) -> Iterator[subprocess.Popen[str]]:
    """Run a curtain on DUMMY1."""
    with running(sys.executable, "-m", "counterlight.gl.curtain", "DUMMY1", folder=ROOT, **on(two_monitors)) as process:
        wait_until(lambda: mapped_windows(two_monitors) == {PROJECTOR}, "the curtain", process)
        yield process


def test_a_window_that_is_moved_goes_back(two_monitors: str, curtain: subprocess.Popen[str]) -> None:
    connection = Display(two_monitors)
    (window,) = [each for each in connection.screen().root.query_tree().children if each.get_geometry().width > 1]
    window.configure(x=0, y=0, width=640, height=480)
    connection.sync()
    connection.close()
    wait_until(lambda: mapped_windows(two_monitors) == {PROJECTOR}, "it is back", curtain)


def test_a_window_waits_for_its_monitor_and_never_covers_another(
    two_monitors: str, curtain: subprocess.Popen[str]
) -> None:
    """The desk's monitor takes the projector's place on the desktop while the projector is off."""
    try:
        xrandr(two_monitors, "--output", "DUMMY1", "--pos", "0x0", "--output", "DUMMY0", "--pos", "1024x0")
        wait_until(lambda: mapped_windows(two_monitors) == {(0, 0, 1024, 768)}, "it goes with its monitor", curtain)
        xrandr(two_monitors, "--output", "DUMMY1", "--off", "--output", "DUMMY0", "--pos", "0x0")
        wait_until(lambda: mapped_windows(two_monitors) == set(), "it is hidden", curtain)
    finally:
        xrandr(two_monitors, "--output", "DUMMY1", "--mode", "1024x768", "--pos", "1280x0")
    wait_until(lambda: mapped_windows(two_monitors) == {PROJECTOR}, "it is back", curtain)


def test_a_monitor_that_is_not_there_is_waited_for(two_monitors: str) -> None:
    """A black window on the desk would not help."""
    words = sys.executable, "-m", "counterlight.gl.curtain", "DUMMY1", "DUMMY0"
    try:
        xrandr(two_monitors, "--output", "DUMMY1", "--off")
        with running(*words, folder=ROOT, **on(two_monitors)) as process:
            wait_until(lambda: mapped_windows(two_monitors) == {DESK}, "the monitor that is there", process)
            xrandr(two_monitors, "--output", "DUMMY1", "--mode", "1024x768", "--pos", "1280x0")
            wait_until(lambda: mapped_windows(two_monitors) == {DESK, PROJECTOR}, "the other one", process)
            process.terminate()
            assert process.wait(PATIENCE_S) == 130
    finally:
        xrandr(two_monitors, "--output", "DUMMY1", "--mode", "1024x768", "--pos", "1280x0")


def test_a_wayland_session_without_an_x_server(tmp_path: Path) -> None:
    line = fail("play", "--list-monitors", DISPLAY="", WAYLAND_DISPLAY="wayland-0")
    assert "this Wayland session has no X server; install one (apt-get install xwayland)" in line
