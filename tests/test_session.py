"""Playback without a window: which frame is shown when, what the keys do. Clock, display and reader are stand-ins.

The real reader, renderer and window are tested in test_video.py, gl/ and test_player.py; here time itself is the input.
"""

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from player.refinement import Certificate, StepBudget
from player.session import Session


@dataclass
class Clock:
    now: float = 100.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Reader:
    """Frames at 25 per second, all decoded at once."""

    count: int = 50
    still: bool = False
    position: int = 0
    released: list[int] = field(default_factory=list)
    news: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        pixels = SimpleNamespace(width=4, height=3)
        self.info = SimpleNamespace(
            path=Path("clip"), format=pixels, frames_per_second=25.0, still=self.still, duration_s=None
        )

    @property
    def ended(self) -> bool:
        return self.position >= self.count

    def poll(self) -> Any:
        if self.ended:
            return None
        self.position += 1
        index = self.position - 1
        return SimpleNamespace(index=index, time_s=index / 25, duration_s=0.04, decode_s=0.001)

    def release(self, frame: Any) -> None:
        self.released.append(frame.index)

    def seek(self, time_s: float) -> None:
        self.position = round(time_s * 25)

    def notices(self) -> list[str]:
        fresh, self.news = self.news, []
        return fresh


@dataclass
class Screen:
    """Records what it is asked to show; also stands in for the renderer."""

    closed: bool = False
    fullscreen: bool = False
    uploaded: list[int] = field(default_factory=list)
    shown: list[tuple[str, bool, bool, int]] = field(default_factory=list)
    state: tuple[str, bool] = ("", False)
    steps: list[int] = field(default_factory=list)
    certified: int = 0

    def upload(self, frame: Any) -> None:
        self.uploaded.append(frame.index)

    def render(self, view: str, *, compensate: bool, frame: int = 0, steps: int = 0) -> None:
        self.state = view, compensate
        self.steps.append(steps)

    def certificate(self) -> Certificate:
        self.certified += 1
        return Certificate(np.ones(3), np.full(3, 0.01))

    def finish(self) -> None: ...

    def poll(self, timeout_s: float) -> list[str]:
        return []

    def present(self, lines: list[str], *, black: bool) -> None:
        self.shown.append((*self.state, black, len(lines)))

    def toggle_fullscreen(self) -> None:
        self.fullscreen = not self.fullscreen


@pytest.fixture
def stage() -> SimpleNamespace:
    return make_stage(Reader())


def make_stage(reader: Reader) -> SimpleNamespace:
    clock, screen = Clock(), Screen()
    session = Session(reader, screen, screen, clock=clock)  # type: ignore[arg-type]
    return SimpleNamespace(clock=clock, screen=screen, reader=reader, session=session)


def advance(stage: SimpleNamespace, seconds: float, step: float = 0.01) -> None:
    end = stage.clock.now + seconds
    while stage.clock.now < end - 1e-9:
        stage.clock.now += step
        stage.session.step()


def test_each_frame_is_shown_at_its_time(stage: SimpleNamespace) -> None:
    stage.session.step()
    assert stage.screen.uploaded == [0]
    advance(stage, 0.39)
    assert stage.screen.uploaded == list(range(10))
    assert stage.session.stats.dropped == 0


def test_frames_that_were_overtaken_are_dropped_and_counted(stage: SimpleNamespace) -> None:
    stage.session.step()
    stage.clock.now += 0.2  # five frames later
    stage.session.step()
    assert stage.screen.uploaded == [0, 5]
    assert stage.session.stats.dropped == 4
    assert sorted(stage.reader.released) == [0, 1, 2, 3, 4, 5]


def test_pause_holds_and_resumes_where_it_was(stage: SimpleNamespace) -> None:
    advance(stage, 0.2)
    stage.session.handle("space")
    count = len(stage.screen.uploaded)
    advance(stage, 10)
    assert len(stage.screen.uploaded) == count
    stage.session.handle("space")
    advance(stage, 0.2)
    assert stage.screen.uploaded == list(range(len(stage.screen.uploaded)))
    assert stage.session.stats.dropped == 0


def test_seeking_goes_from_the_current_position(stage: SimpleNamespace) -> None:
    stage.reader.count = 1000
    advance(stage, 0.4)
    stage.session.handle("right")
    advance(stage, 0.02)
    assert stage.screen.uploaded[-1] == pytest.approx(25 * 5.4, abs=2)  # where it was, to a frame or two
    stage.session.handle("left")
    stage.session.handle("left")
    advance(stage, 0.02)
    assert stage.screen.uploaded[-1] <= 1
    assert stage.session.stats.dropped == 0


def test_seeking_while_paused_shows_the_new_frame(stage: SimpleNamespace) -> None:
    stage.reader.count = 1000
    advance(stage, 0.1)
    stage.session.handle("space")
    stage.session.handle("right")
    advance(stage, 0.1)
    assert stage.screen.uploaded[-1] >= 125
    count = len(stage.screen.uploaded)
    advance(stage, 1)
    assert len(stage.screen.uploaded) == count
    stage.session.handle("space")
    advance(stage, 0.1)
    assert stage.screen.uploaded[-1] == stage.screen.uploaded[count - 1] + 2


def test_keys_change_what_is_shown(stage: SimpleNamespace) -> None:
    advance(stage, 0.05)
    expected = {
        "c": ("projector", False, False, 0),
        "b": ("projector", False, True, 0),
        "v": ("camera", False, True, 0),
        "unknown": ("camera", False, True, 0),
    }
    stage.session.handle("space")
    for key, shown in expected.items():
        stage.session.handle(key)
        stage.session.step()
        assert stage.screen.shown[-1] == shown
    stage.session.handle("i")
    stage.session.step()
    assert stage.screen.shown[-1][3] > 3
    stage.session.handle("f")
    assert stage.screen.fullscreen
    stage.session.handle("q")
    assert stage.session.done


def test_what_the_reader_has_to_say_is_told_at_once(stage: SimpleNamespace, capsys: pytest.CaptureFixture[str]) -> None:
    stage.reader.news = ["decoder stopped; restarted"]
    advance(stage, 0.05)
    assert capsys.readouterr().err == "decoder stopped; restarted\n"
    assert stage.session.stats.notices == ["decoder stopped; restarted"]


def test_a_video_ends_and_a_still_stays() -> None:
    video, still = make_stage(Reader(count=5)), make_stage(Reader(count=1, still=True))
    advance(video, 1.0)
    advance(still, 1.0)
    assert video.session.done
    assert video.screen.uploaded[-1] == 4
    assert not still.session.done
    assert still.screen.uploaded == [0]
    still.session.handle("right")
    advance(still, 0.1)
    assert still.screen.uploaded == [0]


def test_brackets_halve_and_double_the_steps(stage: SimpleNamespace) -> None:
    advance(stage, 0.05)
    for key, steps in (("]", 1), ("]", 2), ("]", 4), ("[", 2), ("[", 1), ("[", 0), ("[", 0)):
        stage.session.handle(key)
        stage.session.step()
        assert stage.screen.steps[-1] == steps


def test_steps_that_follow_the_frame_time_are_counted() -> None:
    reader, clock, screen = Reader(), Clock(), Screen()
    session = Session(reader, screen, screen, clock=clock, budget=StepBudget(3600.0))  # type: ignore[arg-type]
    stage = SimpleNamespace(clock=clock, session=session)
    advance(stage, 0.4)
    assert screen.steps[:6] == [1, 2, 3, 4, 5, 6]  # nothing here takes an hour
    session.handle("[")
    advance(stage, 0.12)
    assert screen.steps[-1] == screen.steps[-2] == session.steps  # a key ends it
    facts = session.run(limit=len(screen.uploaded)).facts["refinement"]
    assert facts["steps"] == pytest.approx(np.mean(screen.steps), abs=0.05)
    assert facts["below_optimum_db"] == pytest.approx(-20 * np.log10(0.99))


def test_the_certificate_is_measured_now_and_then_and_only_to_be_shown(stage: SimpleNamespace) -> None:
    advance(stage, 0.4)
    assert stage.screen.certified == 0
    stage.session.handle("i")
    advance(stage, 1.0)
    assert 2 <= stage.screen.certified <= 3
    assert any("below the optimum" in line for line in stage.session._lines())
