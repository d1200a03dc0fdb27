"""Monitors have unique names, a named monitor is found, and a missing screen is an error in one line."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import glfw
import pytest

from counterlight.errors import AbsentError, InputError
from counterlight.gl import monitors, x11
from counterlight.gl.monitors import Monitor, _unique, after_a_change, find_monitor
from tests.programs import PATIENCE_S, ROOT, on, running

MONITORS = [
    Monitor(0, "eDP-1", 1920, 1080, 60, 0, 0, primary=True),
    Monitor(1, "HDMI-1", 1024, 768, 75, 1920, 0, primary=False),
    Monitor(2, "0", 800, 600, 60, 2944, 0, primary=False),
]


def seen_on(display: str) -> dict[str, Any]:
    """Return what GLFW sees, from a child process, because GLFW keeps the first screen of its process."""
    with running(
        sys.executable, "-W", "error", "-m", "counterlight.gl.probe", "screen", folder=ROOT, **on(display)
    ) as child:
        output, errors = child.communicate(timeout=PATIENCE_S)
    assert (child.returncode, errors) == (0, "")
    answer: dict[str, Any] = json.loads(output)
    return answer


def test_the_server_keeps_a_client_until_glfw_has_connected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Xvfb resets when its last client leaves, and refuses GLFW's connection meanwhile."""
    events: list[str] = []

    @contextmanager
    def connection() -> Iterator[None]:
        events.append("connected")
        yield
        events.append("left")

    monkeypatch.setattr(monitors, "_glfw_runs", lambda: False)
    monkeypatch.setattr(x11, "connection", connection)
    monkeypatch.setattr(glfw, "init", lambda: events.append("GLFW"))
    with pytest.raises(AbsentError, match="GLFW does not start"):
        monitors.start_glfw()
    assert events == ["connected", "GLFW", "left"]


def test_both_monitors_of_a_desktop_are_listed(two_monitors: str) -> None:
    keys = ("index", "name", "width", "height", "x", "y", "primary")
    listed = [tuple(monitor[key] for key in keys) for monitor in seen_on(two_monitors)["monitors"]]
    assert listed == [(0, "DUMMY0", 1280, 720, 0, 0, True), (1, "DUMMY1", 1024, 768, 1280, 0, False)]


@pytest.mark.parametrize(("display", "reason"), [("", "no screen: X11: "), (":12345", "no screen: X11: Failed")])
def test_no_screen_is_one_line_with_a_way_out(display: str, reason: str) -> None:
    error = seen_on(display)["error"]
    assert error.startswith(reason)
    assert "counterlight play --output FILE needs none" in error
    assert "xvfb-run" in error
    assert "\n" not in error


@pytest.mark.parametrize(("wanted", "index"), [("HDMI-1", 1), ("1", 1), (1, 1), ("eDP-1", 0), ("2", 2), ("0", 2)])
def test_a_monitor_is_found_by_its_name_before_its_number(wanted: str | int, index: int) -> None:
    assert find_monitor(MONITORS, wanted).index == index


@pytest.mark.parametrize("wanted", ["VGA-1", "3", "-1", "hdmi"])
def test_a_monitor_that_is_not_there_is_answered_with_those_that_are(wanted: str) -> None:
    with pytest.raises(InputError, match=rf"monitor '{wanted}'.*0 eDP-1 \(1920x1080.*1 HDMI-1 \(1024x768"):
        find_monitor(MONITORS, wanted)


def test_no_monitor_at_all_is_said() -> None:
    with pytest.raises(InputError, match="none is connected"):
        find_monitor([], "0")


def test_monitors_of_one_make_get_different_names() -> None:
    assert _unique(["Epson", "Epson", "Epson (2)", "Epson"]) == ["Epson", "Epson (2)", "Epson (2) (2)", "Epson (3)"]


@pytest.mark.parametrize(
    ("home", "at_home", "there", "act"),
    [
        ("HDMI-1", True, MONITORS, "stay"),
        ("HDMI-1", True, MONITORS[:1], "left"),
        ("HDMI-1", False, MONITORS[:1], "stay"),  # still waiting for its monitor
        ("HDMI-1", False, MONITORS, "return"),
        ("HDMI-1", True, MONITORS[1:], "stay"),  # another monitor has gone, so the numbers have changed
        ("HDMI-1", True, [], "left"),
        (None, False, MONITORS, "stay"),
    ],
)
def test_a_window_follows_its_monitor_by_name(home: str | None, at_home: bool, there: list[Monitor], act: str) -> None:
    assert after_a_change(home, there, at_home=at_home) == act
