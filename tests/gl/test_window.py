"""The player in real windows: GLFW under Xvfb, full screen on a monitor of Xorg, keys pressed, the screen read."""

import json
import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import moderngl
import numpy as np
import pytest

from counterlight.files import exr
from counterlight.gl.context import in_software
from counterlight.response import Response
from tests import screens
from tests.desktop import (
    ON_A_GPU,
    ON_THE_PROCESSOR,
    expected_picture,
    fine_screen,
    playing,
    press,
    screen,
    window_depths,
    xrandr,
)
from tests.media import numbered, write_video
from tests.oracles import encoding
from tests.programs import PATIENCE_S, command, descendants, fail, here, on, running, verb, wait_until
from tests.rooms import write_blurred_room, write_one_to_one_room

WINDOW = (0, 0, 50, 37)  # left, top, width, height of the projector's window on a bare X server
FIRST_MONITOR, SECOND_MONITOR = (0, 0, 360, 216), (360, 0, 304, 232)


@pytest.fixture(scope="module")
def two_monitors(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("two_monitors")
    with screens.two_monitors(folder, FIRST_MONITOR[2:], SECOND_MONITOR[2:]) as display:
        yield display


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("window") / "wall"
    write_blurred_room(folder, np.random.default_rng(7), (44, 60), (37, 50))
    here("build", folder, "--regularize", "0.1")
    return folder


@pytest.fixture(scope="module")
def large_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a room with the second monitor's size, whose camera sees pixel for pixel; refinement is unnecessary."""
    folder = tmp_path_factory.mktemp("window") / "large"
    write_one_to_one_room(folder, (SECOND_MONITOR[3], SECOND_MONITOR[2]))
    here("build", folder, "--regularize", "0.01", "--no-refine")
    return folder


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a film of 5.28 seconds."""
    return write_video(tmp_path_factory.mktemp("film") / "film.mkv", [numbered(n % 20) for n in range(132)])


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("picture") / "picture.png"
    noise = np.random.default_rng(2).uniform(0, 255, (12, 16, 3))
    cv2.imwrite(str(path), cv2.resize(noise, (320, 240), interpolation=cv2.INTER_CUBIC).clip(0, 255).astype(np.uint8))
    return path


def test_full_screen_on_the_chosen_monitor_shows_the_exact_pixels_and_comes_back_with_it(
    two_monitors: str, large_room: Path, picture: Path, tmp_path: Path
) -> None:
    """The second player's monitor, chosen by number, is unplugged and comes back."""
    expected = expected_picture(large_room, picture, tmp_path)
    listed = command("play", "--list-monitors", **on(two_monitors))
    assert listed.returncode == 0
    assert [line.split()[1] for line in listed.stdout.splitlines()] == ["DUMMY0", "DUMMY1"]

    def fills() -> bool:
        return np.array_equal(screen(two_monitors, SECOND_MONITOR), expected)

    with playing(two_monitors, large_room, picture, "--fullscreen", "--monitor", "DUMMY1") as process:
        wait_until(fills, "the picture appears", process)
        assert screen(two_monitors, FIRST_MONITOR).max() == 0  # the desk's monitor stays black
        press(two_monitors, "g")
        wait_until(lambda: screen(two_monitors, FIRST_MONITOR).max() > 200, "its name on the other one", process)
        press(two_monitors, "q")
        assert process.wait(PATIENCE_S) == 0
    words = *verb("play"), *ON_A_GPU, large_room, picture, "--fullscreen", "--monitor", "1"
    with (
        (log := tmp_path / "log").open("w") as file,
        running(*words, errors=file.fileno(), **on(two_monitors)) as process,
    ):
        wait_until(fills, "the picture appears", process)
        assert screen(two_monitors, FIRST_MONITOR).max() == 0
        try:
            xrandr(two_monitors, "--output", "DUMMY1", "--off")
            wait_until(lambda: not fills(), "the monitor goes", process)
            time.sleep(1)
        finally:
            xrandr(two_monitors, "--output", "DUMMY1", "--mode", "304x232", "--pos", "360x0")
        wait_until(fills, "the picture is back", process)
        said = "monitor DUMMY1 has gone; its window waits until it is back", "monitor DUMMY1 is back"
        wait_until(lambda: tuple(log.read_text().splitlines()[:2]) == said, "both are said", process)


def test_a_screen_of_ten_bits_gets_codes_of_ten_bits(large_room: Path, tmp_path: Path) -> None:
    """A ramp from OpenEXR has finer steps than 8 bits. The X server returns codes of 10 bits."""
    shape = SECOND_MONITOR[3], SECOND_MONITOR[2]
    ramp = np.broadcast_to(np.linspace(0, 0.4, shape[1], dtype=np.float32)[:, None], (*shape, 3))
    exr.write_rgb(tmp_path / "ramp.exr", ramp)
    here("play", large_room, tmp_path / "ramp.exr", "--backend", "gl", "--output", tmp_path / "drive.exr")
    drive = exr.read_rgb(tmp_path / "drive.exr")
    expected = encoding.encode(drive, Response("linear").inverse_table(), bits=10).astype(int)
    box = (0, 0, shape[1], shape[0])
    with screens.one_screen(tmp_path, (shape[1], shape[0]), depth=30) as display:
        assert "10 bits" in command("play", "--list-monitors", **on(display)).stdout

        def exact() -> bool:
            wrong = np.abs(fine_screen(display, box) - expected)
            # a dither threshold within 1e-6 of a code may round differently
            return bool(wrong.max() <= 1 and np.mean(wrong > 0) < 1e-4)

        with playing(display, large_room, tmp_path / "ramp.exr", "--dither", "none") as process:
            wait_until(exact, "the ramp", process)
            assert window_depths(display) == {30}
            press(display, "q")
            assert process.wait(PATIENCE_S) == 0
        with playing(display, large_room, tmp_path / "ramp.exr", "--bits", "8") as process:
            wait_until(lambda: bool(window_depths(display)), "the window", process)
            assert 30 not in window_depths(display)
            press(display, "q")
            assert process.wait(PATIENCE_S) == 0


def test_a_monitor_that_is_not_there_or_of_another_size(two_monitors: str, room: Path, picture: Path) -> None:
    line = fail("play", room, picture, "--monitor", "HDMI-7", **on(two_monitors))
    assert "HDMI-7" in line
    assert "DUMMY0" in line
    line = fail("play", room, picture, "--fullscreen", "--monitor", "DUMMY1", **on(two_monitors))
    assert "304x232, the calibration is for a projector of 50x37" in line


@pytest.mark.parametrize("how", [ON_A_GPU, ON_THE_PROCESSOR], ids=["gpu", "processor"])
def test_keys_in_a_window(xvfb: str, room: Path, picture: Path, tmp_path: Path, how: tuple[str, ...]) -> None:
    """c, v, b, i, s and q are really pressed. The window is at the upper left of a bare X server."""
    corrected = expected_picture(room, picture, tmp_path, how=how)
    plain = expected_picture(room, picture, tmp_path, "--no-compensation", how=how)
    assert np.abs(corrected - plain).max() > 20

    def shows(wanted: np.ndarray | int) -> Callable[[], bool]:
        return lambda: bool(np.all(screen(xvfb, WINDOW) == wanted))

    with playing(xvfb, room, picture, folder=tmp_path, how=how) as process:
        wait_until(shows(corrected), "the corrected picture", process)
        press(xvfb, "c")
        wait_until(shows(plain), "the plain picture", process)
        press(xvfb, "c")
        press(xvfb, "b")
        wait_until(shows(0), "black", process)
        press(xvfb, "b")
        wait_until(shows(corrected), "the corrected picture again", process)
        press(xvfb, "s")
        wait_until(lambda: bool(list(tmp_path.glob("counterlight-*.png"))), "a screenshot", process)
        press(xvfb, "i")
        wait_until(lambda: not shows(corrected)(), "statistics over it", process)
        press(xvfb, "q")
        assert process.wait(PATIENCE_S) == 0
    saved = cv2.imread(str(next(iter(tmp_path.glob("counterlight-*.png")))))[..., ::-1]
    np.testing.assert_array_equal(saved, corrected)


def test_a_window_without_a_gpu_is_drawn_by_the_processor(
    xvfb: str, room: Path, picture: Path, tmp_path: Path, gl_context: moderngl.Context
) -> None:
    """A view of another size has its own picture. Shows of other tests request OpenGL, or do not select a backend."""
    stats = tmp_path / "stats.json"
    options = "--view", "camera", "--stats", stats, "--image-display-duration", "0.1"
    done = command("play", room, picture, *options, **on(xvfb))
    assert done.returncode == 0, done.stderr
    assert (path_of(stats) == "cpu") == in_software(gl_context.info["GL_RENDERER"])


def path_of(stats: Path) -> str:
    """Return the backend that has drawn a show: the processor ("cpu"), or the path of a GPU."""
    return str(json.loads(stats.read_text())["gpu_path"]["name"])


def test_a_clip_plays_to_its_end_in_a_window(xvfb: str, room: Path, film: Path, tmp_path: Path) -> None:
    stats = tmp_path / "stats.json"
    done = command("play", room, film, "--backend", "gl", "--stats", stats, "--start", "4", **on(xvfb))
    assert done.returncode == 0, done.stderr
    numbers = json.loads(stats.read_text())
    # the film lasts 5.28 s at 25 frames per second, and starts at 4 s
    assert numbers["frames"] + numbers["dropped"] == pytest.approx(32, abs=1)
    chosen = numbers["gpu_path"]  # the shaders were measured, on OpenGL 4.3, and words with the faster shader
    measured = {key: value for key, value in chosen.items() if key.endswith("_ms")}
    assert {"fragment_ms", "compute_ms"} < measured.keys()
    assert chosen[f"{chosen['name']}_ms"] == min(measured.values()) > 0


def test_a_decoder_that_dies_does_not_take_the_player_down(xvfb: str, room: Path, film: Path, tmp_path: Path) -> None:
    with playing(xvfb, room, film, "--loop") as process:
        for kill in (False, True, True):
            if kill:
                (decoder,) = descendants(process.pid)
                os.kill(decoder, signal.SIGSEGV)
            before = screen(xvfb, WINDOW)  # the screen still shows the last test's picture
            wait_until(lambda b=before: not np.array_equal(screen(xvfb, WINDOW), b), "the film goes on", process)
            time.sleep(0.5)  # wait until frames that were decoded before the crash have been shown
        press(xvfb, "q")
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert errors.count("decoder stopped (signal 11, SIGSEGV)") == 2


def test_a_damaged_map_does_not_replace_the_one_that_plays(
    xvfb: str, room: Path, picture: Path, tmp_path: Path
) -> None:
    folder, stats = tmp_path / "wall", tmp_path / "stats.json"
    shutil.copytree(room, folder)
    steps = "--refine", "4", "--refine-from", "map"  # by default, the maps decide
    corrected = expected_picture(folder, picture, tmp_path, *steps)
    with playing(xvfb, folder, picture, "--osd", "off", "--stats", stats, *steps) as process:

        def shows(wanted: np.ndarray) -> Callable[[], bool]:
            return lambda: np.array_equal(screen(xvfb, WINDOW), wanted)

        wait_until(shows(corrected), "the corrected picture", process)
        entries = folder / "correction" / "entries.exr"
        whole = entries.read_bytes()
        entries.write_bytes(whole[: len(whole) // 2])
        press(xvfb, "r", "Control_L")
        press(xvfb, "c")
        wait_until(lambda: not shows(corrected)(), "the plain picture", process)
        press(xvfb, "c")
        wait_until(shows(corrected), "the old map's picture", process)
        entries.write_bytes(whole)
        here("build", folder, "--regularize", "0.5")
        smoother = expected_picture(folder, picture, tmp_path, *steps)
        assert np.abs(smoother - corrected).max() > 5
        press(xvfb, "r", "Control_L")
        wait_until(shows(smoother), "the new map's picture", process)
        press(xvfb, "q")
        assert process.wait(PATIENCE_S) == 0
    assert path_of(stats) == "fragment"
    (notice,) = json.loads(stats.read_text())["notices"]
    assert "entries.exr" in notice


def test_pictures_of_a_list_follow_each_other(
    xvfb: str, room: Path, tmp_path: Path, gl_context: moderngl.Context
) -> None:
    for index, level in enumerate((60, 120, 200)):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.full((30, 40, 3), level, np.uint8))
    listed, stats = tmp_path / "list.m3u", tmp_path / "stats.json"
    listed.write_text("0.png\ngone.png\n1.png\n2.png\n")
    options = "--image-display-duration", "0.2", "--stats", stats
    done = command("play", room, listed, *options, **on(xvfb))
    assert done.returncode == 0, done.stderr
    numbers = json.loads(stats.read_text())
    assert numbers["frames"] == 3
    assert len(numbers["notices"]) == 1
    assert "gone.png: no such file" in numbers["notices"][0]
    assert (path_of(stats) == "cpu") == in_software(gl_context.info["GL_RENDERER"])
