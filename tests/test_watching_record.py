"""A folder records the watcher's captures and decisions, within limits of size, for reading later."""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.tools.watching.record import EVERY_S, OLDER, PAUSE_S, STATES, Record, report
from counterlight.tools.watching.watcher import Sight
from counterlight.unattended.watch_link import Answer
from tests.programs import ROOT

HOLDING, MOVED = Answer("holding", "nothing has changed", captures=5), Answer("camera moved", "put it back", captures=9)


def sight(rng: np.random.Generator) -> Sight:
    return Sight(rng.integers(0, 255, (30, 40, 3), np.uint8), rng.random((6, 8, 3)), rng.random((15, 40, 3)))


def test_pictures_and_states_are_kept_when_they_are_due(tmp_path: Path, rng: np.random.Generator) -> None:
    record, seen = Record(tmp_path), sight(rng)
    answers = [(0, HOLDING), (1, HOLDING), (2, MOVED), (PAUSE_S + 1, HOLDING), (EVERY_S + PAUSE_S + 2, HOLDING)]
    for now_s, answer in answers:
        record.keep(1e9 + now_s, answer, lambda: seen)
    lines = [json.loads(line) for line in (tmp_path / STATES).read_text().splitlines()]
    assert [(line["time"] - 1e9, bool(line["pictures"])) for line in lines] == [
        (0, True),
        (2, False),  # too soon after the first pictures
        (PAUSE_S + 1, True),
        (EVERY_S + PAUSE_S + 2, True),
    ]
    assert len(list(tmp_path.glob("*.png"))) == 9
    stem = lines[0]["pictures"]
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / f"{stem}-capture.png"))[..., ::-1], seen.shot)
    shown = cv2.imread(str(tmp_path / f"{stem}-shown.png"))[..., ::-1]
    assert seen.shown is not None
    linear = np.where(shown <= 10, shown / 255 / 12.92, ((shown / 255 + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(linear, seen.shown, atol=1 / 200)  # half a code value near white is 1 / 220
    assert cv2.imread(str(tmp_path / f"{stem}-blocks.png")).shape == (15, 40, 3)
    told = [line.split("  ")[1].strip() for line in report(tmp_path)]
    assert told == ["holding", "camera moved", "holding", "holding"]


def test_the_folder_stays_within_its_limits(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("counterlight.tools.watching.record.MOST_LINES", 2000)
    most, record = 40_000, Record(tmp_path, 40_000)
    for number in range(40):
        record.keep(1e9 + EVERY_S * number, HOLDING, lambda: sight(rng))
        assert sum(path.stat().st_size for path in tmp_path.glob("*.png")) <= most
    assert all((tmp_path / name).stat().st_size < 3000 for name in (STATES, OLDER))
    last = list(report(tmp_path))[-1]
    assert (tmp_path / f"{last.split()[-1]}-capture.png").exists()


def test_a_recorded_evening_is_printed(tmp_path: Path) -> None:
    words = sys.executable, "-P", "-m", "counterlight.tools.watching", str(tmp_path)
    with pytest.raises(InputError, match="play --watch-record"):
        list(report(tmp_path))
    assert subprocess.run(words, cwd=ROOT, capture_output=True).returncode == 2
    record = Record(tmp_path)
    record.keep(1e9, HOLDING, lambda: None)
    record.keep(1e9 + 1, MOVED, lambda: None)
    with (tmp_path / STATES).open("a") as file:
        file.write('{"time": 1, "sta')
    said = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    assert [("holding" in said[0], "nothing has changed" in said[0]), "put it back" in said[1]] == [(True, True), True]
