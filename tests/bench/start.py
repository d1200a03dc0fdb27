"""The start of a show: wall-clock and processor time from the command to the first picture on the screen."""

import os
import resource
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from Xlib import X
from Xlib.display import Display

from tests.bench.change import write_clip
from tests.programs import on, succeed, verb
from tests.screens import one_screen

SIZE, SCREEN = "256x192", (640, 480)
CLIP, RATE, RUNS = (192, 256), 25, 7
QUIET = "--no-config", "--no-audio", "--osd", "off"
LOOK_S = 0.005


def start() -> Iterator[str]:
    """From `counterlight play` to the first picture, 256x192, in a window; medians."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        succeed("simulate", "wall", "--projector", SIZE, "--camera", SIZE, "-o", folder / "room")
        succeed("build", folder / "room")
        write_clip(folder / "clip.mkv", CLIP, RATE)
        with one_screen(folder, SCREEN) as display:
            runs = [first_picture(folder, display) for _ in range(RUNS + 1)][1:]  # the first run reads from the disk
            wall_s, spent_s = np.median(runs, axis=0)
            yield f"first picture after {wall_s:.2f} s; to the end of the program, {spent_s:.2f} s of processor time"


def first_picture(folder: Path, display: str) -> tuple[float, float]:
    """Returns the seconds until a bright pixel is on the screen, and the processor time of a show of one frame."""
    words = *verb("play"), folder / "room", folder / "clip.mkv", *QUIET, "--frames", "1"
    began, before = time.perf_counter(), _spent_s()
    with (
        closing(Display(display)) as screen,
        subprocess.Popen(list(map(str, words)), env=os.environ | on(display), stdout=subprocess.DEVNULL) as process,
    ):
        while not _is_bright(screen):
            assert process.poll() is None, "no picture"
            time.sleep(LOOK_S)
        wall_s = time.perf_counter() - began
    assert process.returncode == 0
    return wall_s, _spent_s() - before


def _spent_s() -> float:
    """Returns the processor time of all ended child processes and of their children."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return ended.ru_utime + ended.ru_stime


def _is_bright(display: Display) -> bool:
    found = display.screen().root.get_image(0, 0, *SCREEN, X.ZPixmap, 0xFFFFFFFF)
    return int(np.frombuffer(found.data, np.uint8).max()) > 0
