"""`acquire --preview` in real windows: live picture, keys, clipping marks, and the start of the acquisition."""

import re
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.desktop import mapped_windows, press, screen, title_that_gets_keys
from tests.programs import PATIENCE_S, on, running, verb, wait_until
from tests.rooms import write_blurred_room

PROJECTOR = (21, 30)
MARK = (255, 0, 160)


@pytest.fixture
def room(tmp_path: Path) -> Path:
    write_blurred_room(tmp_path / "room", np.random.default_rng(5), (18, 26), PROJECTOR)
    return tmp_path / "room"


@contextmanager
def aiming(display: str, *arguments: object, windows: int = 2, **environment: str) -> Iterator[subprocess.Popen[str]]:
    with running(*verb("acquire"), *arguments, "--preview", **environment, **on(display)) as process:
        wait_until(lambda: len(mapped_windows(display)) == windows, "the preview's window", process)
        wait_until(lambda: title_that_gets_keys(display) == "Counterlight preview", "the preview's keys", process)
        yield process


def preview_box(display: str) -> tuple[int, int, int, int]:
    """Return the box of the larger window."""
    return max(mapped_windows(display), key=lambda box: box[2] * box[3])


def marked(display: str) -> float:
    """Return the share of the preview in the clipping colour."""
    return float(np.all(screen(display, preview_box(display)) == MARK, axis=2).mean())


def press_until(display: str, key: str, reached: Callable[[], bool], process: subprocess.Popen[str]) -> int:
    """Return how often a key was pressed. The window takes some frames to show the effect."""
    deadline, count = time.monotonic() + PATIENCE_S, 0
    while not reached():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, key
        press(display, key)
        count += 1
        time.sleep(0.3)
    return count


def test_what_clips_is_marked_the_exposure_follows_and_the_acquisition_begins(
    xvfb: str, room: Path, tmp_path: Path
) -> None:
    words = ["--camera", f"simulated:{room}", "--window", "--scheme", "graycode", "-o", tmp_path / "out"]
    with aiming(xvfb, *words) as process:
        wait_until(lambda: screen(xvfb, preview_box(xvfb)).mean() > 30, "light in the preview", process)
        legend = marked(xvfb)  # the legend's swatch has the same colour
        up = press_until(xvfb, "plus", lambda: marked(xvfb) > legend + 0.2, process)
        assert up >= 1  # two keys would exceed the range: the brightest pixel starts at 80 % of it
        press_until(xvfb, "minus", lambda: marked(xvfb) <= legend, process)
        press(xvfb, "minus")
        press(xvfb, "space")
        printed, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors
    (times,) = re.findall(r"to go on after an interruption: --exposures (\S+)", printed)
    steps = np.log2(float(times)) * 3
    assert abs(steps - round(steps)) < 0.01  # thirds of a stop, printed with four digits
    assert round(steps) <= 0
    assert "own pattern good" in printed
    recorded = (tmp_path / "out.captures" / "session.toml").read_text()
    assert f"exposures=({times},)" in recorded


@pytest.mark.parametrize("key", ["q", "Escape"])
def test_it_ends_without_beginning(xvfb: str, room: Path, tmp_path: Path, key: str) -> None:
    with aiming(xvfb, "--camera", f"simulated:{room}", "--window", "-o", tmp_path / "out") as process:
        press(xvfb, key)
        printed, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, errors) == (0, "")
    assert printed.startswith("nothing acquired; next: counterlight acquire --camera ")
    assert not list(tmp_path.glob("out*"))


def test_a_machine_vision_camera_is_aimed_on_the_other_monitor(two_monitors: str, tmp_path: Path) -> None:
    pytest.importorskip("pypylon", reason="pypylon is not installed: pip install 'counterlight[pylon]'")
    projector = (1280, 0, 1024, 768)
    words = ["--camera", "pylon:0", "--monitor", "DUMMY1", "--exposures", "8", "-o", tmp_path / "out"]
    with aiming(two_monitors, *words, PYLON_CAMEMU="1") as process:
        (box,) = mapped_windows(two_monitors) - {projector}
        left, top, width, height = box
        assert left + width <= 1280
        assert top + height <= 720
        wait_until(lambda: np.ptp(screen(two_monitors, box)[:, -9:]) > 30, "its test picture", process)
        wait_until(lambda: bool(np.all(screen(two_monitors, projector) == 255)), "white", process)
        # the longest exposure is 10 s, so the second key is refused with a message
        for key in ("plus", "plus", "minus", "q"):
            press(two_monitors, key)
        printed, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, errors) == (0, "")
    assert printed.startswith("nothing acquired; next: counterlight acquire --camera ")


def test_other_programs_aim_in_a_folder(xvfb: str, tmp_path: Path) -> None:
    exchange = tmp_path / "exchange"
    words = ["--camera", f"folder:{exchange}", "--projector", "30x21", "-o", tmp_path / "out"]
    with aiming(xvfb, *words, windows=1) as process:
        assert np.all(cv2.imread(str(exchange / "aim" / "pattern.png")) == 255)
        corner = (slice(-9, None), slice(-9, None))  # next to the text
        assert not screen(xvfb, preview_box(xvfb))[corner].any()
        cv2.imwrite(str(exchange / "aim" / "one.png"), np.full((48, 64, 3), 255, np.uint8))
        wait_until(lambda: bool(np.all(screen(xvfb, preview_box(xvfb))[corner] == MARK)), "what clips", process)
        press(xvfb, "space")
        printed, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, printed) == (2, "")
    assert "waiting for" in errors
