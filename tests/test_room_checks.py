"""Checks of the room during a show: when a check begins, how its result is used, and that none outlives the show."""

import math
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from counterlight.show.command_line import read_options
from counterlight.show.from_options import check_of
from counterlight.show.registry import CommandError
from counterlight.unattended.room_checks import LONGEST_S, Outcome, RoomChecks
from tests.programs import PATIENCE_S, fail
from tests.stage import Clock, Reader, Screen, Stage


def check(code: str, clock: Clock, every_s: float = 60.0) -> RoomChecks:
    return RoomChecks([sys.executable, "-c", code], every_s, clock)


def wait(done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def ended(checks: RoomChecks) -> Outcome:
    found: list[Outcome] = []

    def poll() -> bool:
        outcome = checks.outcome()
        found.extend([outcome] if outcome else [])
        return bool(found)

    wait(poll)
    return found[0]


def test_a_check_is_due_a_while_after_the_last_and_its_last_line_is_told() -> None:
    clock = Clock()
    checks = check("print('first'); print('moved: corrected'); print(); raise SystemExit(3)", clock)
    assert not checks.due
    clock.now += 60
    assert checks.due
    checks.begin()
    assert checks.running
    assert not checks.due
    clock.now += 30
    assert ended(checks) == Outcome(3, "moved: corrected")
    clock.now += 59
    assert not checks.due
    clock.now += 1
    assert checks.due
    assert checks.outcome() is None


def test_much_that_is_said_holds_up_nothing() -> None:
    checks = check("print('x' * 1_000_000); print('last')", Clock())
    checks.begin()
    assert ended(checks) == Outcome(0, "last")


def test_a_check_that_hangs_is_ended_and_so_is_one_that_the_show_leaves(tmp_path: Path) -> None:
    clock = Clock()
    checks = check("import time; time.sleep(1000)", clock)
    checks.begin()
    clock.now += LONGEST_S + 1
    outcome = checks.outcome()
    assert outcome is not None
    assert outcome.code
    assert "did not end" in outcome.said
    checks.begin()
    checks.close()
    assert not checks.running


class Shown:
    """A show whose check is due after 5 s."""

    def __init__(self, *readers: Reader, code: str = "print('moved: corrected')", drifts: bool = False) -> None:
        self.clock = Clock()
        self.checks = check(code, self.clock, every_s=5.0)
        self.stage = Stage(*readers, loop_list=True, checks=self.checks)
        self.stage.drifts = drifts
        self.stage.advance(0.1)

    @property
    def paused(self) -> bool:
        return self.stage.session.manner.paused

    def come_due(self) -> None:
        self.clock.now += 10
        self.stage.advance(0.02)

    def go_on(self) -> None:
        """Advance until no check runs."""

        def ended() -> bool:
            self.stage.advance(0.01)
            return not self.checks.running

        wait(ended)


def test_a_single_medium_stands_still_meanwhile_and_what_is_found_is_taken_over() -> None:
    show, fresh = Shown(Reader(count=1000), drifts=True), Screen()
    show.stage.fresh.append(fresh)
    show.come_due()
    assert show.paused
    show.go_on()
    assert not show.paused
    show.stage.advance(0.1)
    assert show.stage.session.renderer is fresh
    assert show.stage.session.stats.notices == ["moved: corrected"]


def test_a_room_that_is_the_same_is_not_read_again_and_a_pause_stays_one() -> None:
    show = Shown(Reader(count=1000), code="print('nothing has changed')")
    show.stage.press("space")
    show.come_due()
    assert show.checks.running
    show.go_on()
    assert show.paused
    assert show.stage.session.stats.notices == []


def test_who_lets_a_paused_show_go_on_during_a_check_is_obeyed() -> None:
    show = Shown(Reader(count=1000), code="print('nothing has changed')")
    show.stage.press("space")
    show.come_due()
    show.stage.press("space")
    show.go_on()
    assert not show.paused


def test_of_several_media_none_is_interrupted() -> None:
    show = Shown(Reader("a", count=20), Reader("b", count=20))
    show.come_due()
    assert not show.checks.running
    show.stage.advance(1.0)  # a has 0.8 s left
    assert show.checks.running
    assert show.paused
    show.go_on()
    assert not show.paused


def test_a_room_that_is_lost_is_told_and_the_show_goes_on() -> None:
    show = Shown(Reader(count=1000), code="print('the camera has moved'); raise SystemExit(3)", drifts=True)
    show.come_due()
    show.go_on()
    assert show.stage.session.stats.notices == ["the room's check: the camera has moved"]
    assert not show.paused


def test_a_check_that_is_asked_for_begins_at_once_and_its_outcome_is_told() -> None:
    """The check begins although none is due and the show has several media."""
    show = Shown(Reader("a", count=1000), Reader("b"), code="print('nothing has changed; next: counterlight play')")
    commands = show.stage.commands
    assert commands.get("checking") is False
    assert commands.run("check-room") == "checking the room"
    with pytest.raises(CommandError, match="a check is running"):
        commands.run("check-room")
    show.stage.advance(0.02)
    assert commands.get("checking") is True
    assert show.paused
    with pytest.raises(CommandError, match="a check is running"):
        commands.run("check-room")
    show.go_on()
    assert not show.paused
    assert commands.get("notices") == ["nothing has changed"]
    assert commands.run("check-room") == "checking the room"
    show.checks.close()


def test_without_a_camera_nothing_is_checked() -> None:
    stage = Stage(Reader())
    with pytest.raises(CommandError, match="start with --check-with"):
        stage.commands.run("check-room")
    assert stage.commands.get("checking") is False


def test_a_check_that_cannot_begin_is_told_and_the_show_goes_on() -> None:
    show = Shown(Reader(count=1000))
    show.checks._command = ["/nowhere"]
    show.come_due()
    assert "No such file" in show.stage.session.stats.notices[0]
    assert not show.paused
    assert not show.checks.due


def test_options_say_how_often_and_with_which_camera() -> None:
    words = [
        "room",
        "a.png",
        "--no-config",
        "--check-every",
        "10",
        "--check-with",
        "--camera 'folder:my room' --wait 60",
    ]
    assert check_of(read_options(words, "")) == (["--camera", "folder:my room", "--wait", "60"], 600.0)
    assert check_of(read_options(words[:3], "")) is None
    assert check_of(read_options([*words[:3], *words[-2:]], ""))[1] == math.inf  # checks begin only on request


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--check-every", "10"], "needs --check-with"),
        (["--check-every", "0", "--check-with", "x"], "--check-every"),
        (["--check-every", "1", "--check-with", "'--camera"], "quote it as for a shell"),
        (["--check-with", "--camera v4l2:0", "--output", "x.png"], "--output"),
    ],
)
def test_what_cannot_be_checked_with_is_refused(tmp_path: Path, arguments: list[str], says: str) -> None:
    assert says in fail("play", tmp_path, tmp_path / "a.png", "--no-config", *arguments)
