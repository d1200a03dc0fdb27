"""Patterns in a real GLFW window under Xvfb, seen by a simulated camera that reads the desktop's pixels."""

import filecmp
import sys
from pathlib import Path

import numpy as np

from tests.joint_rooms import join, write_halves
from tests.programs import PATIENCE_S, fail, on, running, succeed
from tests.rooms import write_blurred_room

SHOW = """
import numpy as np, sys
from PIL import ImageGrab
from counterlight.gl.pattern_window import PatternWindow
codes = np.random.default_rng(3).integers(0, 256, (51, 67, 3)).astype(np.uint8)
window = PatternWindow((51, 67), None)
window.show(codes)
left, top, right, below = window.place
for _ in range(100):
    seen = np.asarray(ImageGrab.grab().convert("RGB"))[top:below, left:right]
    if np.array_equal(seen, codes):
        break
window.release()
print(np.array_equal(seen, codes))
"""


SHOW_TWO = """
import numpy as np
from counterlight.tools.acquisition.cameras.window import open_screens
codes = np.random.default_rng(3).integers(0, 256, (768, 2304, 3)).astype(np.uint8)
codes[720:, :1280] = 0
with open_screens((), ["DUMMY0", "DUMMY1"], desktop=True) as (screen, shapes):
    screen.show(codes)
    for _ in range(100):
        if np.array_equal(screen.look(), codes):
            break
    print(shapes, np.array_equal(screen.look(), codes))
"""


def test_a_window_shows_a_picture_code_by_code(xvfb: str) -> None:
    with running(sys.executable, "-c", SHOW, **on(xvfb)) as process:
        shown, errors = process.communicate(timeout=PATIENCE_S)
    assert shown.strip() == "True", errors


def test_an_acquisition_through_a_window_is_bit_identical_to_one_in_memory(xvfb: str, tmp_path: Path) -> None:
    room = tmp_path / "room"
    write_blurred_room(room, np.random.default_rng(5), (18, 26), (21, 30))
    words = ["--camera", f"simulated:{room}", "--scheme", "graycode", "--name", "twin"]
    succeed("acquire", *words, "-o", tmp_path / "memory")
    printed = succeed("acquire", *words, "--window", "-o", tmp_path / "window", **on(xvfb))
    assert "own pattern good" in printed
    for folder in ("memory", "memory.captures/captures"):
        one, other = tmp_path / folder, tmp_path / folder.replace("memory", "window")
        names = sorted(path.name for path in one.iterdir())
        assert names == sorted(path.name for path in other.iterdir())
        assert filecmp.cmpfiles(one, other, names, shallow=False) == (names, [], [])


def test_each_monitor_shows_its_part_of_the_raster(two_monitors: str) -> None:
    with running(sys.executable, "-c", SHOW_TWO, **on(two_monitors)) as process:
        shown, errors = process.communicate(timeout=PATIENCE_S)
    assert shown.strip() == "((720, 1280), (768, 1024)) True", errors


def test_the_desktop_itself_is_no_projector(two_monitors: str, tmp_path: Path) -> None:
    room = tmp_path / "room"
    write_blurred_room(room, np.random.default_rng(5), (18, 26), (21, 30))
    here = on(two_monitors)
    words = ["acquire", "--camera", f"simulated:{room}", "-o", tmp_path / "out", "--monitor"]
    assert "DUMMY0 is the desktop itself" in fail(*words, "DUMMY0", **here)
    assert "1024x768, the calibration is for" in fail(*words, "DUMMY1", **here)
    two = *words, "DUMMY1", "--monitor", "DUMMY1"
    assert "--monitor: 2 given, of projectors 1; give one for each" in fail(*two, **here)
    joint = join(write_halves(tmp_path), tmp_path / "joint")
    twice = "acquire", "--camera", f"simulated:{joint}", *two[3:]
    assert "monitor DUMMY1: named for two projectors; each has its own" in fail(*twice, **here)
