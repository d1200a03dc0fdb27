"""The watcher's process, between a player that sends frames and a camera: a moved picture, and a camera that fails."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import BinaryIO

import numpy as np
import pytest

from counterlight import calibration
from counterlight.calibration import StoredCalibration
from counterlight.files.picture_files import write_png
from counterlight.pipeline.drift import Moved
from counterlight.tools.watching.cameras import open_cameras
from counterlight.unattended import watch_link
from counterlight.unattended.watch_link import Answer, Light, Picture, Situation, Start
from tests.drifted_rooms import write_changed
from tests.oracles.formulas import grid_means
from tests.programs import PATIENCE_S, here, running

SHIFT = 0.5, -0.25
NEAR = 0.05  # in pixels; boxes of light and interpolated pictures differ by this much in detail


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> StoredCalibration:
    folder = tmp_path_factory.mktemp("watched") / "room"
    here("simulate", "wall", "-o", folder, "--projector", "64x48", "--camera", "80x60")
    return calibration.read(folder)


class _Watched:
    """A running watcher and its answers."""

    def __init__(self, process: "subprocess.Popen[str]", messages: BinaryIO) -> None:
        self._printed, self._messages, self.answers = process.stdout, messages, Queue[Answer]()
        self.process, self.listener = process.pid, Thread(target=self._listen, daemon=True)
        self.listener.start()

    def send(self, message: watch_link.Message) -> None:
        self._messages.write(watch_link.packed(message))

    def show(self, drive: np.ndarray) -> None:
        """Show a picture at this moment."""
        now_s = time.monotonic()
        self.send(Light(now_s, grid_means(drive)))
        self.send(Picture(now_s, drive.astype(np.float16)))

    def until(self, state: str) -> Answer:
        """Returns the next answer with a state."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            answer = self.answers.get(timeout=max(deadline - time.monotonic(), 0.01))
            if answer.state == state:
                return answer

    def _listen(self) -> None:
        assert self._printed
        for line in self._printed:
            self.answers.put(Answer.parse(line.encode()))


@contextmanager
def watching(
    stored: StoredCalibration, camera: str, folder: Path, record: str = "", factor: int = 1
) -> Iterator[_Watched]:
    readable, writable = os.pipe()
    words = sys.executable, "-m", "counterlight.tools.watching"
    with running(*words, errors=None, given=readable) as process, open(writable, "wb", buffering=0) as messages:
        os.close(readable)
        watched = _Watched(process, messages)
        watched.send(Start(str(stored.folder), (camera,), (), factor, 1 / 60, str(folder), record=record))
        yield watched
        messages.close()
        assert process.wait(PATIENCE_S) == 0
        watched.listener.join()


def test_a_moved_picture_is_found_from_the_film(
    stored: StoredCalibration, tmp_path: Path, rng: np.random.Generator
) -> None:
    write_changed(tmp_path / "now", stored, shift=SHIFT)
    height, width = stored.calibration.projector.shape
    with watching(stored, f"simulated:{tmp_path / 'now'}", tmp_path) as watched:
        watched.until("looking")
        while True:
            coarse = rng.random((height // 8 + 1, width // 8 + 1, 3)).repeat(8, axis=0).repeat(8, axis=1)
            watched.show(coarse[:height, :width])
            answer = watched.answers.get(timeout=PATIENCE_S)
            rows = np.array(answer.projectors[0].to_raster) if answer.projectors else np.eye(3)
            middle = Moved(rows, np.ones(3)).at_corners(stored.calibration.projectors[0])[0]
            if np.abs(middle - SHIFT).max() < NEAR:
                break
    paint = np.load(tmp_path / watch_link.PAINT)
    assert paint.shape == (*stored.calibration.camera.shape, 3)


def test_a_slow_simulated_camera_sees_the_newest_pictures(stored: StoredCalibration, tmp_path: Path) -> None:
    start = Start(str(stored.folder), (f"simulated:{stored.folder}",), (), 1, 1 / 60, str(tmp_path))
    drive = np.zeros((*stored.calibration.projector.shape, 3), np.float16)
    with open_cameras(start, stored.calibration) as camera:
        for time_s in range(5):
            camera.show(Picture(float(time_s), drive))
        np.testing.assert_allclose([camera.arrival() for _ in range(2)], [3, 4], atol=0.001)


def test_a_missing_camera_is_reported_again_and_again(stored: StoredCalibration, tmp_path: Path) -> None:
    with watching(stored, f"folder:{tmp_path / 'nowhere'}", tmp_path) as watched:
        for _ in range(2):
            assert "nowhere: no such folder" in watched.until("no camera").reason


def test_photographs_of_another_size_are_refused(stored: StoredCalibration, tmp_path: Path) -> None:
    folder = tmp_path / "captures"
    folder.mkdir()
    with watching(stored, f"folder:{folder}", tmp_path) as watched:
        while "64x48 pixels, the calibration's camera has 80x60" not in watched.answers.get(timeout=PATIENCE_S).reason:
            write_png(folder / f"{time.monotonic_ns()}.png", np.zeros((48, 64, 3), np.uint8))


def test_an_evening_is_recorded_until_its_folder_is_gone(
    stored: StoredCalibration, tmp_path: Path, rng: np.random.Generator
) -> None:
    (folder := tmp_path / "record").mkdir()
    height, width = stored.calibration.projector.shape
    with watching(stored, f"simulated:{stored.folder}", tmp_path, record=str(folder)) as watched:
        watched.until("looking")
        while not list(folder.glob("*-capture.png")):
            watched.show(rng.random((height, width, 3)))
            watched.answers.get(timeout=PATIENCE_S)
        shutil.rmtree(folder)
        watched.send(Situation(frozen=True))
        assert f"--watch-record: [Errno 2] No such file or directory: '{folder}" in watched.until("frozen").reason
