"""The player's connection to the watcher: messages to the watcher, use of its answers, and effects of its faults."""

import json
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import pytest

from counterlight.calibration import Device
from counterlight.errors import InputError
from counterlight.raster import Region
from counterlight.response import Response
from counterlight.show.polled import watching_of
from counterlight.show.registry import CommandError
from counterlight.show.session import Session
from counterlight.show.watching import BURST, PICTURE_EVERY_S, Bursts, Watching
from counterlight.tools.watching.__main__ import _Process
from counterlight.unattended import watcher
from counterlight.unattended.watch_link import GAINS, GRID, PAINT, ROW_GAINS, Answer, Projected, Start, packed
from counterlight.unattended.watcher import LONGEST_REST_S, REST_S, SILENT_S, Watcher
from tests.programs import PATIENCE_S, ROOT
from tests.stage import Reader, Stage

FACTOR = 2  # of the pictures that the watcher gets
PROJECTOR, CAMERA = Device(150, 200, Response("srgb")), Device(6, 8, Response("linear"))


class Watched:
    """A show of 25 frames per second next to a watcher (tests/watcher_program.py)."""

    def __init__(self, folder: Path, manner: str = "answers", *readers: Reader, dims: bool = False) -> None:
        self.folder = folder
        self.dims, self.manner = dims, manner
        readers = readers or (Reader(count=100_000),)
        self.stage = Stage(*readers, watching=self._watching)
        self.session, self.commands = self.stage.session, self.stage.commands

    def _watching(self, stage: Stage) -> Watching:
        region = Region(0, 0, PROJECTOR.width, PROJECTOR.height)
        calibration = SimpleNamespace(regions=(region,), projectors=(PROJECTOR,), camera=CAMERA)
        stage.read_last = SimpleNamespace(calibration=calibration, white=2.0, drift=None)
        command = sys.executable, "-m", "tests.watcher_program", str(self.folder), self.manner
        self.watcher = Watcher(command, stage.session.notice, stage.clock)
        start = Start("room", ("v4l2:0",), (0.03,), FACTOR, 0.04, str(self.folder), "independent")
        return Watching(stage.session, self.watcher, start, dims=self.dims)

    def __enter__(self) -> "Watched":
        return self

    def __exit__(self, *_: object) -> None:
        assert self.stage.show._watching is not None
        self.stage.show._watching.close()

    def until(self, met: Callable[[], object], seconds: float = 0.01) -> None:
        """Play until something has happened in the other process."""

        deadline = time.monotonic() + PATIENCE_S
        while not met():
            assert time.monotonic() < deadline
            self.stage.advance(seconds)
            time.sleep(seconds)  # the show's clock is no faster than the watcher's

    def messages(self, kind: str = "") -> list[dict[str, Any]]:
        path = self.folder / "messages"
        lines = path.read_text().splitlines(keepends=True) if path.exists() else []
        found = [json.loads(line) for line in lines if line.endswith("\n")]
        return [each for each in found if kind in ("", each["kind"])]

    def told_frozen(self) -> bool:
        """Whether the correction is frozen in the latest message."""
        return any(each["frozen"] for each in self.messages("Situation")[-1:])

    @property
    def state(self) -> dict[str, Any]:
        return dict(self.commands.get("watch-state"))

    def answer(self, answer: Answer) -> None:
        """Let the watcher give this answer from now on, and wait for it."""
        new = self.folder / "new"
        new.write_bytes(answer.line())
        new.replace(self.folder / "answer")
        self.until(lambda: self.state["captures"] == answer.captures)


def moved(x: float, gain: float = 1.0) -> Projected:
    return Projected(((1.0, 0.0, x), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (gain, gain, 1.0), 0.02)


@pytest.fixture(autouse=True)
def in_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def test_the_watcher_gets_each_frame_and_bursts_of_pictures(tmp_path: Path) -> None:
    with Watched(tmp_path) as show:
        show.until(lambda: len(show.messages("Picture")) >= 13)
        show.commands.set("blackout", True)
        show.until(lambda: show.messages("Light")[-1]["number"] == 0)
    first, *_ = show.messages()
    assert [first[name] for name in ("kind", "cameras", "exposures", "factor")] == ["Start", ["v4l2:0"], [0.03], FACTOR]
    lights, pictures = show.messages("Light"), show.messages("Picture")
    seen = [light["number"] for light in lights if light["number"]]
    assert seen == sorted(seen)
    assert lights[0]["shape"] == [*GRID, 3]
    assert pictures[0]["shape"] == [75, 100, 3]
    shown = {(light["time_s"], light["number"]) for light in lights}
    assert all((picture["time_s"], picture["number"]) in shown for picture in pictures)
    numbers, at_s = ([picture[name] for picture in pictures] for name in ("number", "time_s"))
    gaps = np.flatnonzero(np.diff(numbers) > 1) + 1  # there is a gap between two bursts
    assert len(gaps) >= 2
    assert np.all(np.diff(gaps) == BURST)
    assert np.all(np.abs(np.diff([at_s[gap] for gap in gaps]) - BURST * PICTURE_EVERY_S) <= 0.05)  # within one frame


@pytest.mark.parametrize("frames_per_s", [24, 25, 60])
@pytest.mark.parametrize("begins_s", [0.0, 0.11])
def test_bursts_follow_a_camera_of_five_captures_per_second(frames_per_s: int, begins_s: float) -> None:
    bursts = Bursts((begins_s, begins_s + 0.05, 0.2))
    shown = np.arange(0, 20, 1 / frames_per_s)
    taken = np.array([bursts.takes(at_s) for at_s in shown])
    assert 3.5 <= taken.mean() * frames_per_s <= 5  # pictures per second
    exposures = begins_s + 0.2 * np.arange(1, 90)
    frames = [
        shown[np.searchsorted(shown, each, "right") - 1 : np.searchsorted(shown, each + 0.05)] for each in exposures
    ]
    seen = [np.isin(each, shown[taken]).all() for each in frames]
    assert np.mean(seen) * 5 >= 1  # captures per second whose frames are all known


def test_a_still_picture_is_sent_and_text_over_the_picture_is_not(tmp_path: Path) -> None:
    with Watched(tmp_path, "answers", Reader(still=True)) as show:
        show.until(lambda: show.messages("Picture"))
        show.commands.set("stats", True)
        show.until(show.told_frozen)
        assert show.state["state"] == "holding"
        count = len(show.messages("Light"))
        show.commands.set("stats", False)
        show.until(lambda: len(show.messages("Light")) > count)
        assert not show.told_frozen()


def test_answers_are_applied_and_frozen(tmp_path: Path) -> None:
    np.save(tmp_path / PAINT, paint := np.full((*CAMERA.shape, 3), 0.5, np.float16))
    with Watched(tmp_path, dims=True) as show:
        corrections = show.stage.screen.corrections
        show.answer(Answer("correcting", "drift", (moved(0.5, 0.9),), captures=3, confidence=0.7))
        field = (((0.1, 0.2, 0.3), (0.3, 0.2, 0.1)),)
        show.answer(Answer("correcting", "drift", (moved(0.5, 0.9),), field, captures=4, confidence=0.7))
        assert len(corrections) == 2
        np.testing.assert_array_equal(corrections[0].projectors[0].to_raster[0], (1, 0, 0.5))
        assert corrections[0].white == corrections[1].white == 0.9
        np.testing.assert_array_equal(corrections[1].ambient, np.float32(field))
        np.testing.assert_array_equal(corrections[1].paint, paint)
        assert {name: show.state[name] for name in ("moved_px", "gain", "added_light", "unsure_px", "state")} == {
            "moved_px": 0.5,
            "gain": 0.9,
            "added_light": 0.1,
            "unsure_px": 0.02,
            "state": "correcting",
        }
        show.commands.set("watch-freeze", True)
        show.answer(Answer("correcting", "drift", (moved(0.7),), captures=5))
        assert len(corrections) == 2
        assert show.state["state"] == "frozen"
        show.until(show.told_frozen)
        show.commands.set("watch-freeze", False)
        show.until(lambda: len(corrections) == 3)
        show.stage.advance(25)
        rows = show.commands.get("watch-history")
        assert len(rows) == 2
        assert rows[0][1:] == [0.5, 0.9, 0.0, 0.7]
        assert show.session.stats.notices == []


def test_row_gains_reach_the_player_in_their_file(tmp_path: Path, rng: np.random.Generator) -> None:
    gains = rng.uniform(*ROW_GAINS, (*CAMERA.shape, 3)).astype(np.float32)
    gains[2:] = 1
    process = _Process(Start("room", (), (), 2, 0.04, str(tmp_path)))
    answers = [Answer("correcting", "dust", (moved(0.5),), captures=3 + i, row_gains=i) for i in range(3)]
    process._watcher = Mock(answer=Mock(side_effect=answers), row_gains=lambda: gains)
    with Watched(tmp_path) as show:
        corrections = show.stage.screen.corrections
        for count in (1, 2, 3):
            show.answer(process.newest())
            assert len(corrections) == count
        assert corrections[0].row_gains is None
        np.testing.assert_array_equal(corrections[2].row_gains, gains)
        assert show.state["learned"] == pytest.approx(2 / CAMERA.height, abs=1e-4)  # four digits
        gains[0, :2] = (0.5,), (2,)
        np.save(tmp_path / GAINS, gains)
        (tmp_path / "answer").write_bytes(replace(answers[2], row_gains=9).line())
        show.until(lambda: show.session.stats.notices)
        assert (
            "gains.npy of shape (6, 8, 3) and 0.5 to 2, expected (6, 8, 3) and 0.5 to 1.15"
            in show.session.stats.notices[0]
        )
        assert len(corrections) == 3


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (
            Answer("correcting", projectors=(moved(5.0),)),
            "corners 5.0 pixels from the calibration, expected 4.0",
        ),
        (Answer("correcting", projectors=(moved(0.0, 0.4),)), "gain [0.4, 0.4, 1.0], expected 0.5 to 1.5"),
        (Answer("correcting", projectors=(moved(0.0), moved(0.0))), "2 projectors, expected 1"),
        (Answer("correcting", projectors=(moved(0.0),), ambient=(((1.0, 2.0),),)), "ambient light of shape (1, 1, 2)"),
        (Answer("correcting", projectors=(moved(0.0),), ambient=(((1.0, 2.0, 3.0),),)), "No such file"),
    ],
)
def test_an_answer_beyond_the_limits_changes_nothing(tmp_path: Path, answer: Answer, why: str) -> None:
    with Watched(tmp_path) as show:
        show.answer(Answer("correcting", projectors=(moved(0.5),), captures=3))
        (tmp_path / "answer").write_bytes(answer.line())
        show.until(lambda: show.session.stats.notices)
        assert why in show.session.stats.notices[0]
        assert len(show.stage.screen.corrections) == 1
        assert show.state["moved_px"] == 0.5


@pytest.mark.parametrize(
    ("manner", "said", "again"),
    [
        ("dies", "its process has ended with 3: the camera is on fire", 0),
        ("raves", "it sent nonsense", 0),
        ("hangs", f"it has said nothing for {SILENT_S:.0f} s", SILENT_S),
    ],
)
def test_a_faulty_watcher_is_reported_once_and_started_again_after_a_pause(
    tmp_path: Path, manner: str, said: str, again: float
) -> None:
    with Watched(tmp_path, manner) as show:
        clock, rests = show.stage.clock, []
        for _ in range(5):
            show.until(lambda: show.watcher.running)
            began_s = clock.now
            clock.now += again
            show.until(lambda: not show.watcher.running)
            assert clock.now - began_s < again + 60  # in the show's time, in which a frame counts for 0.01 s
            ended_s = clock.now
            assert show.state["state"] == "starting"
            while not show.watcher.running:
                show.stage.advance(0.1)
            rests.append(clock.now - ended_s)
        np.testing.assert_allclose(rests, [REST_S, 2 * REST_S, 4 * REST_S, 8 * REST_S, LONGEST_REST_S], atol=0.3)
        assert [line for line in show.session.stats.notices if said in line] == show.session.stats.notices
        assert len(show.session.stats.notices) == 1
        assert show.session.stats.frames > 100


def test_a_watcher_that_floods_costs_nothing_else(tmp_path: Path) -> None:
    with Watched(tmp_path, "floods") as show:
        show.until(lambda: show.state["captures"] == 7)
        show.stage.advance(2)
        assert show.session.stats.notices == []


def test_a_watcher_that_reads_nothing_gets_whole_messages_or_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A slow watcher reads what the player has kept for it: no message is cut, and the newest are missing."""
    most, size = 1 << 21, 75 * 100 * 3 * 2
    monkeypatch.setattr(watcher, "MOST_WAITING", most)
    with Watched(tmp_path, "waits") as show:
        show.until(lambda: show.watcher.running)
        show.stage.advance(1.5 * most / size / 5)
        (tmp_path / "go").touch()
        show.until(lambda: len(show.messages("Picture")) > 0.9 * most / size)
        show.until(lambda: show.messages("Light")[-1]["time_s"] > show.stage.clock.now - 1)
        assert show.session.stats.notices == []
    times = np.array([each["time_s"] for each in show.messages("Light")])
    assert np.diff(times).max() > 1  # whole messages are missing; all others could be read


def test_a_show_without_a_watcher_says_so(tmp_path: Path) -> None:
    stage = Stage()
    assert stage.commands.get("watch-state") is None
    assert stage.commands.get("watch-history") is None
    with pytest.raises(CommandError, match="no camera watches the room; start with --watch CAMERA"):
        stage.commands.set("watch-freeze", True)
    assert isinstance(stage.session, Session)


def test_a_watcher_without_a_room_ends_and_says_why(tmp_path: Path) -> None:
    start = Start(str(tmp_path / "gone"), ("v4l2:0",), (0.03,), 2, 0.04, str(tmp_path))
    words = sys.executable, "-m", "counterlight.tools.watching"
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stderr is not None
        process.stdin.write(packed(start))
        process.stdin.flush()  # stays open: the end of the input would end the watcher, too
        said = process.stderr.read().decode()
        assert process.wait(PATIENCE_S) == 1
    assert str(tmp_path / "gone") in said.splitlines()[-1]


def test_a_record_needs_a_camera_and_a_folder(tmp_path: Path) -> None:
    region = Region(0, 0, PROJECTOR.width, PROJECTOR.height)
    room = SimpleNamespace(others=(), calibration=SimpleNamespace(regions=(region,)), maps=Mock())
    session = cast(Session, SimpleNamespace(room=SimpleNamespace(read_last=room)))
    (tmp_path / "file").touch()
    options = Namespace(watch=None, watch_record=tmp_path / "file" / "record", calibration=tmp_path, exposures=())
    with ExitStack() as stack:
        with pytest.raises(InputError, match="name the camera with --watch"):
            watching_of(options, session, lambda: 0.02, stack)
        options.watch = ["v4l2:0"]
        with pytest.raises(InputError, match=r"record: cannot be made \(Not a directory\)"):
            watching_of(options, session, lambda: 0.02, stack)
