"""Followers keep their leader's position, and shows begin at a time of day, on stages whose clocks differ."""

from collections.abc import Callable
from datetime import datetime
from typing import Any

import pytest

from counterlight.show.in_step import Curtain, Follower, Leader, cue_of
from counterlight.unattended.cues import Cue, Heard
from counterlight.unattended.hours import begins_at
from tests.programs import fail
from tests.stage import Reader, Stage

FRAME_S = 0.04
APART_S = 5000.0  # the follower's clock minus the leader's


class Wire:
    """Replaces a Beacon and a Listener, and knows the difference of the clocks exactly.

    late_s : age of received cues in seconds.
    """

    def __init__(self, late_s: float = 0.1) -> None:
        self._cues: list[Cue] = []
        self._late = round(late_s / 0.01)
        self.cut, self.offset_s = False, 0.0

    def tell(self, cue: Cue) -> None:
        self._cues.append(cue)

    @property
    def heard(self) -> Heard | None:
        if self.cut or len(self._cues) <= self._late:
            return None
        return Heard(self._cues[-1 - self._late], self.offset_s, 0.001)


class Pair:
    """Leader and follower that advance together step by step."""

    def __init__(self, make: Callable[[], list[Reader]] = lambda: [Reader(count=1000)], **options: Any) -> None:
        self.wire = Wire()
        self.leader, self.follower = Stage(*make(), **options), Stage(*make(), **options)
        self.follower.clock.now += APART_S
        self._acts = (
            Leader(self.leader.session, self.wire).poll,  # type: ignore[arg-type]
            Follower(self.follower.session, self.wire).poll,  # type: ignore[arg-type]
        )

    def advance(self, seconds: float) -> None:
        stages = self.leader, self.follower
        self.wire.offset_s = self.leader.clock.now - self.follower.clock.now
        for _ in range(round(seconds / 0.01)):
            for act in self._acts:
                act()
            for stage in stages:
                stage.advance(0.01)

    @property
    def apart_s(self) -> float:
        times = [stage.session.playback.now_s for stage in (self.leader, self.follower)]  # type: ignore[union-attr]
        return float(times[1] - times[0])

    def shown(self) -> tuple[int, int]:
        return self.leader.screen.uploaded[-1], self.follower.screen.uploaded[-1]


@pytest.mark.parametrize("head_start_s", [0.1, 0.7, 8.0])
def test_a_follower_comes_to_show_the_leader_s_frames(head_start_s: float) -> None:
    pair = Pair()
    pair.leader.advance(head_start_s)
    pair.advance(5)
    assert abs(pair.apart_s) < 0.005
    for _ in range(50):
        pair.advance(0.03)
        assert abs(pair.shown()[0] - pair.shown()[1]) <= 1


def test_one_that_is_ahead_waits() -> None:
    pair = Pair()
    pair.follower.advance(0.5)
    before = pair.follower.screen.uploaded[-1]
    pair.advance(3)
    assert abs(pair.apart_s) < 0.005
    assert pair.follower.screen.uploaded[-1] > before


def test_a_leader_s_seek_pause_step_and_speed_are_followed() -> None:
    pair = Pair()
    pair.advance(1)
    pair.leader.commands.run("seek", 20, "absolute")
    pair.advance(2)
    assert abs(pair.apart_s) < 0.005
    pair.leader.commands.set("pause", True)
    pair.advance(1)
    assert pair.shown()[0] == pair.shown()[1]
    pair.leader.commands.run("frame-step")
    pair.advance(1)
    assert pair.shown()[0] == pair.shown()[1]
    count = len(pair.follower.screen.uploaded)
    pair.advance(2)
    assert len(pair.follower.screen.uploaded) == count  # the follower has not sought again
    pair.leader.commands.set("speed", 2.0)
    pair.leader.commands.set("pause", False)
    pair.advance(2)
    assert pair.follower.commands.get("speed") == 2.0
    assert abs(pair.apart_s) < 0.01


def test_what_a_follower_is_ordered_otherwise_is_put_right() -> None:
    pair = Pair()
    pair.advance(1)
    pair.follower.commands.run("seek", 30, "absolute")
    pair.follower.commands.set("pause", True)
    pair.follower.commands.set("speed", 0.5)
    pair.advance(5)
    assert abs(pair.apart_s) < 0.005
    assert not pair.follower.commands.get("pause")


def test_round_about_a_medium_that_loops() -> None:
    """The reader loops a medium of two seconds; the follower is near its end, the leader at its beginning."""
    pair = Pair(lambda: [Reader(count=50, loop=True)], loop_file=True)
    pair.follower.advance(1.9)
    pair.advance(7)
    assert abs((pair.apart_s + 1) % 2 - 1) < 0.005
    assert max(pair.follower.screen.uploaded) < 10_000
    assert (
        sum(b < a for a, b in zip(pair.follower.screen.uploaded, pair.follower.screen.uploaded[1:], strict=False)) <= 1
    )


def items() -> list[Reader]:
    return [Reader("a", count=100), Reader("b", count=100), Reader("c", count=100)]


def test_the_list_is_followed_item_by_item() -> None:
    pair = Pair(items, loop_list=True)
    pair.advance(1)
    pair.leader.commands.set("playlist-pos", 2)
    pair.advance(2)
    assert pair.follower.commands.get("playlist-playing-pos") == 2
    assert abs(pair.apart_s) < 0.005
    pair.advance(4)  # at the end of a round of the list
    assert [stage.commands.get("playlist-playing-pos") for stage in (pair.leader, pair.follower)] == [0, 0]
    assert abs(pair.apart_s) < 0.005


def test_a_list_that_ends_before_is_reported_once_in_a_while(capsys: pytest.CaptureFixture[str]) -> None:
    pair = Pair()
    pair.wire.tell = lambda cue: None  # type: ignore[method-assign,assignment]
    pair.wire._cues = [Cue(5, 0.0, 100.0, 1.0, False, True)] * 20
    pair.advance(4)
    assert capsys.readouterr().err.count("the leader plays medium 6, this list ends before") == 1
    assert pair.follower.screen.uploaded[-1] > 90  # and the follower still plays


def test_a_leader_that_falls_silent_ends_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    pair = Pair()
    pair.advance(2)
    pair.wire.cut = True
    before = pair.follower.screen.uploaded[-1]
    pair.advance(3)
    assert pair.follower.screen.uploaded[-1] >= before + 74
    assert pair.follower.commands.get("in-step")["in_touch"] is False
    pair.wire.cut = False
    pair.advance(1)
    errors = capsys.readouterr().err
    assert errors.count("in touch with the leader") == 2
    assert errors.count("the leader is silent; going on alone") == 1


def test_stills_stay(capsys: pytest.CaptureFixture[str]) -> None:
    pair = Pair(lambda: [Reader(count=1, still=True)])
    pair.advance(3)
    assert pair.follower.screen.uploaded == [0]


def test_before_anything_plays_there_is_no_item() -> None:
    stage = Stage(Reader(opens_s=5))
    stage.advance(1)
    assert cue_of(stage.session).item == -1


def curtain(stage: Stage, begins: datetime) -> Curtain:
    start_s = stage.clock.now
    return Curtain(stage.session, begins, lambda: begins.timestamp() - 2.0 + (stage.clock.now - start_s))


def up(stage: Stage, made: Curtain, seconds: float, step: float = 0.01) -> None:
    for _ in range(round(seconds / step)):
        made.poll()
        stage.advance(step)


@pytest.mark.parametrize("opens_s", [0.0, 2.5])
def test_a_show_begins_by_the_clock(opens_s: float, capsys: pytest.CaptureFixture[str]) -> None:
    """The show begins in two seconds: black until then, then at the position of a punctual start."""
    stage = Stage(Reader(count=1000, opens_s=opens_s))
    made = curtain(stage, datetime(2026, 11, 22, 20, 0, 0))
    begun_s = stage.clock.now + 2.0
    up(stage, made, 1.9)
    assert all(black for _, _, black in stage.screen.shown)
    assert stage.session.manner.paused
    assert "begins at 20:00:00" in capsys.readouterr().err
    up(stage, made, 2.1)
    assert not stage.screen.shown[-1][2]
    playback = stage.session.playback
    assert playback is not None
    assert playback.now_s == pytest.approx(stage.clock.now - begun_s, abs=0.011)  # within a step of the stage


def test_a_time_that_has_passed_begins_at_once() -> None:
    stage = Stage(Reader(count=1000))
    made = Curtain(stage.session, datetime(2026, 11, 22, 20, 0, 0), lambda: datetime(2026, 11, 22, 20, 5).timestamp())
    up(stage, made, 0.3)
    assert not stage.screen.shown[-1][2]
    assert stage.screen.uploaded[0] == 0
    assert stage.screen.uploaded[-1] < 10  # the medium plays from its beginning


@pytest.mark.parametrize(
    ("words", "now", "day", "hour"),
    [
        ("20:00:00", 10, 22, 20),
        ("20:00", 19, 22, 20),
        ("20:00", 21, 22, 20),
        ("01:30:00", 20, 23, 1),
        ("23:00", 1, 21, 23),
    ],
)
def test_the_nearest_time_is_meant(words: str, now: int, day: int, hour: int) -> None:
    found = begins_at(words, datetime(2026, 11, 22, now))
    assert (found.day, found.hour) == (day, hour)


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--at", "25:00", "expected a time such as 20:00:00, found '25:00'"),
        ("--at", "tonight", "expected a time such as 20:00:00"),
        ("--lead", "left:port", "expected [HOST:]PORT, found 'left:port'"),
        ("--lead", "left", "expected [HOST:]PORT"),
        ("--follow", "left:99999", "expected HOST[:PORT], found 'left:99999'"),
    ],
)
def test_wrong_options_are_reported_in_a_line(option: str, value: str, message: str) -> None:
    assert message in fail("play", "room", "clip.mkv", option, value)
