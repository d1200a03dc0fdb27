"""Two projectors in two real windows: the X server shows each projector's part of the raster."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests import screens
from tests.desktop import Box, expected_picture, mapped_windows, playing, press, screen, xrandr
from tests.joint_rooms import CAMERA, LEFT, RIGHT, SIDE_BY_SIDE, join, write_monitors
from tests.programs import PATIENCE_S, ROOT, fail, here, on, running, wait_until

MONITORS = {"DUMMY0": (0, 0, 360, 216), "DUMMY1": (360, 0, 304, 232)}


@pytest.fixture(scope="module")
def two_monitors(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    first, second = (box[2:] for box in MONITORS.values())
    with screens.two_monitors(tmp_path_factory.mktemp("two_monitors"), first, second) as display:
        yield display


@pytest.fixture(scope="module")
def monitors_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a room whose projectors have the sizes of the two monitors, named in the calibration."""
    folder = tmp_path_factory.mktemp("monitors")
    sizes = [(height, width) for _, _, width, height in MONITORS.values()]
    names = [part for name in MONITORS for part in ("--monitor", name)]
    room = join(write_monitors(folder, sizes), folder / "joint", *names)
    here("build", room, "--regularize", "0.01", "--no-refine")
    return room


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("picture") / "picture.png"
    noise = np.random.default_rng(2).uniform(0, 255, (9, 16, 3))
    cv2.imwrite(str(path), cv2.resize(noise, CAMERA[::-1], interpolation=cv2.INTER_CUBIC).clip(0, 255).astype(np.uint8))
    return path


def parts(raster: np.ndarray, sizes: list[tuple[int, int]]) -> list[np.ndarray]:
    """Return the raster's pictures of (height, width), side by side."""
    lefts = np.cumsum([0, *(width for _, width in sizes)])
    return [raster[:height, left : left + width] for (height, width), left in zip(sizes, lefts, strict=False)]


def shows(display: str, boxes: tuple[Box, ...], wanted: list) -> Callable[[], bool]:
    return lambda: all(np.all(screen(display, box) == part) for box, part in zip(boxes, wanted, strict=True))


def test_each_window_shows_its_part_and_keys_act_on_both(xvfb: str, joint: Path, picture: Path, tmp_path: Path) -> None:
    raster = expected_picture(joint, picture, tmp_path)
    corrected = parts(raster, [LEFT, RIGHT])
    plain = parts(expected_picture(joint, picture, tmp_path, "--no-compensation"), [LEFT, RIGHT])
    assert raster.shape[:2] == (LEFT[0], LEFT[1] + RIGHT[1])
    assert all(np.abs(one - other).max() > 20 for one, other in zip(corrected, plain, strict=True))
    with playing(xvfb, joint, picture, "--osd", "off") as process:
        for key, wanted in (("", corrected), ("c", plain), ("b", [0, 0]), ("b", plain), ("c", corrected)):
            if key:
                press(xvfb, key)
            wait_until(shows(xvfb, SIDE_BY_SIDE, wanted), f"{key or 'start'}: the picture of each", process)
        press(xvfb, "v")  # the camera's view, shrunk into the first window
        wait_until(shows(xvfb, SIDE_BY_SIDE[1:], [0]), "black in the second window", process)
        assert screen(xvfb, SIDE_BY_SIDE[0]).max() > 40
        for _ in range(4):
            press(xvfb, "v")
        wait_until(shows(xvfb, SIDE_BY_SIDE, corrected), "the projectors' pictures again", process)
        press(xvfb, "i")
        wait_until(lambda: not shows(xvfb, SIDE_BY_SIDE[:1], corrected[:1])(), "statistics in the first", process)
        assert shows(xvfb, SIDE_BY_SIDE[1:], corrected[1:])()
        press(xvfb, "q")
        assert process.wait(PATIENCE_S) == 0


def test_each_monitor_is_filled_with_its_own_picture(
    two_monitors: str, monitors_room: Path, picture: Path, tmp_path: Path
) -> None:
    """The calibration names the monitors. One monitor is unplugged and comes back."""
    sizes = [(height, width) for _, _, width, height in MONITORS.values()]
    corrected = parts(expected_picture(monitors_room, picture, tmp_path), sizes)
    wanted = parts(expected_picture(monitors_room, picture, tmp_path, "--no-compensation"), sizes)
    boxes = tuple(MONITORS.values())
    with playing(two_monitors, monitors_room, picture, "--fullscreen", "--osd", "off", "--no-compensation") as process:
        wait_until(shows(two_monitors, boxes, wanted), "both monitors filled", process)
        try:
            xrandr(two_monitors, "--output", "DUMMY1", "--off")
            wait_until(shows(two_monitors, boxes[:1], wanted[:1]), "the first one stays", process)
        finally:
            xrandr(two_monitors, "--output", "DUMMY1", "--mode", "304x232", "--pos", "360x0")
        wait_until(shows(two_monitors, boxes, wanted), "the second one is back", process)
        press(two_monitors, "c")
        wait_until(shows(two_monitors, boxes, corrected), "the corrected pictures", process)
        press(two_monitors, "b")
        wait_until(shows(two_monitors, boxes, [0, 0]), "black on both", process)
        press(two_monitors, "g")
        both = [lambda box=box: bool(screen(two_monitors, box).max() > 200) for box in boxes]
        wait_until(lambda: all(named() for named in both), "names on both", process)
        press(two_monitors, "q")
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert errors.splitlines()[:2] == [
        "monitor DUMMY1 has gone; its window waits until it is back",
        "monitor DUMMY1 is back",
    ]


def test_the_curtain_covers_all_monitors(two_monitors: str) -> None:
    """The curtain covers each named monitor that is connected."""
    names = ["DUMMY1", "HDMI-7", "DUMMY0"]
    with running(sys.executable, "-m", "counterlight.gl.curtain", *names, folder=ROOT, **on(two_monitors)) as process:
        wait_until(lambda: mapped_windows(two_monitors) == set(MONITORS.values()), "a window on each", process)


def test_windows_are_moved_by_the_names_of_their_monitors(
    two_monitors: str, joint: Path, picture: Path, tmp_path: Path
) -> None:
    wanted = parts(expected_picture(joint, picture, tmp_path), [LEFT, RIGHT])
    settings = tmp_path / "player.toml"
    settings.write_text('[keys]\n"n" = "set monitor DUMMY1,DUMMY0"')
    there = "--monitor", "DUMMY0", "--monitor", "DUMMY1"
    with playing(two_monitors, joint, picture, *there, "--osd", "off", "--config", settings) as process:
        for key, lefts in (("", (0, 360)), ("n", (360, 0))):
            if key:
                press(two_monitors, key)
            boxes = tuple((left, 0, width, height) for left, (height, width) in zip(lefts, (LEFT, RIGHT), strict=True))
            wait_until(shows(two_monitors, boxes, wanted), f"the pictures at {lefts}", process)
            assert mapped_windows(two_monitors) == set(boxes)
        press(two_monitors, "q")
        assert process.wait(PATIENCE_S) == 0


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--monitor", "DUMMY0"], "monitors: 1 named, the calibration has 2 projectors; name one for each"),
        (["--monitor", "DUMMY0", "--monitor", "DUMMY0"], "monitor DUMMY0: named for two projectors"),
        (["--monitor", "DUMMY0", "--monitor", "HDMI-7"], "monitor 'HDMI-7': not there"),
        (["--fullscreen"], "monitor DUMMY0: 360x216, the calibration is for a projector of 44x30"),
    ],
)
def test_monitors_that_do_not_suit(
    two_monitors: str, joint: Path, picture: Path, arguments: list[str], complaint: str
) -> None:
    assert complaint in fail("play", joint, picture, *arguments, **on(two_monitors))


def test_more_projectors_than_monitors(xvfb: str, joint: Path, picture: Path) -> None:
    line = fail("play", joint, picture, "--fullscreen", "--any-size", **on(xvfb))
    assert "2 projectors need as many monitors, found: 0 screen (1280x720" in line
    with playing(xvfb, joint, picture) as process:  # in windows, which stay windows when `f` is pressed
        wait_until(lambda: len(mapped_windows(xvfb)) == 2, "two windows", process)
        wait_until(lambda: screen(xvfb, SIDE_BY_SIDE[1]).max() > 0, "the picture", process)
        press(xvfb, "f")
        wait_until(lambda: screen(xvfb, SIDE_BY_SIDE[0]).max() > 200, "what is wrong, on the screen", process)
        assert mapped_windows(xvfb) == set(SIDE_BY_SIDE)
