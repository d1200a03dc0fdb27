"""The next medium when media open slowly, fail, or are requested: programme and session on a simulated clock."""

import os
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from counterlight.errors import InputError
from counterlight.media.medium import Border, Medium
from counterlight.show.lookup import MOST_WAITING, LookUp
from counterlight.show.media import Media
from counterlight.show.programme import HURRY_S, LIST_S
from counterlight.show.registry import CommandError
from counterlight.show.stats import MOST_NOTICES
from counterlight.show.stats_page import facts
from counterlight.unattended.waiting import LONGEST_RETRY_S, RETRY_S
from tests.stage import Reader, Stage

SLOW_S = 3.0


def playing(*readers: Reader, **options: object) -> Stage:
    """Return a stage on which the first medium plays."""
    stage = Stage(*readers, **options)  # type: ignore[arg-type]
    stage.advance(0.1)
    assert stage.commands.get("path") == readers[0].path
    return stage


def position(stage: Stage) -> tuple[str, int, int]:
    """Return the playing medium, its position in the list, and the list's position."""
    return stage.commands.get("path"), stage.commands.get("playlist-playing-pos"), stage.commands.get("playlist-pos")


def test_the_screen_is_black_and_commands_are_answered_until_the_first_medium_is_open() -> None:
    stage = Stage(Reader("a", opens_s=SLOW_S))
    stage.advance(SLOW_S / 2)
    assert stage.screen.shown == [("", False, True)]
    assert stage.commands.get("frames") == 0
    with pytest.raises(CommandError, match="no medium is open"):
        stage.commands.get("time-pos")
    stage.commands.set("pause", True)
    stage.commands.set("speed", 2)
    stage.advance(SLOW_S)
    assert (stage.commands.get("pause"), stage.commands.get("speed"), stage.screen.uploaded) == (True, 2, [0])


def test_what_plays_goes_on_until_the_next_medium_has_its_first_frame() -> None:
    stage = playing(Reader("a", count=1000), Reader("b", count=1000, opens_s=SLOW_S))
    stage.commands.run("playlist-next")
    assert position(stage) == ("a", 0, 1)
    stage.advance(SLOW_S - 0.1)
    assert position(stage) == ("a", 0, 1)
    assert stage.screen.uploaded == list(range(len(stage.screen.uploaded)))
    assert len(stage.screen.uploaded) > 25 * (SLOW_S - 0.1)
    stage.advance(0.2)
    assert position(stage) == ("b", 1, 1)
    assert stage.readers["a"].closed


def test_the_next_medium_is_opened_before_its_turn() -> None:
    stage = playing(Reader("a", count=400), Reader("b", count=50, opens_s=2.0))
    assert stage.begun == ["a"]
    stage.advance(15.9 + 0.2)  # a lasts 16 s
    assert stage.begun == ["a", "b"]
    assert position(stage) == ("b", 1, 1)
    assert stage.screen.uploaded[:403] == [*range(400), 0, 1, 2]


def test_the_next_medium_is_opened_before_its_turn_even_if_a_frame_is_due_in_every_loop() -> None:
    stage = playing(Reader("a", count=100), Reader("b", count=50, opens_s=1.0))
    stage.advance(3.0, step=0.04)
    assert (stage.begun, stage.screen.prepared) == (["a", "b"], ["b"])


def test_a_change_past_media_that_fail_takes_no_loop() -> None:
    """The end of a at 104 s: the last frame of a and the first frame of b come in consecutive loops."""
    broken = [Reader(name, error=f"{name}: gone", opens_s=0.5) for name in "xyz"]
    stage = Stage(Reader("a", count=100), *broken, Reader("b", count=50))
    stage.show.step()
    stage.advance(3.98, step=0.02)
    assert stage.screen.uploaded == list(range(100))
    assert stage.session.stats.notices == []
    stage.clock.now = 104.001
    stage.show.step()
    assert stage.screen.uploaded[100:] == [0]
    assert position(stage) == ("b", 4, 4)
    assert stage.session.stats.notices == ["x: gone", "y: gone", "z: gone"]
    assert stage.session.stats.percentile_ms("change", 100) == pytest.approx(1)


def test_a_change_is_as_late_as_the_first_frame_of_the_next_medium() -> None:
    """a ends at 101 s. b takes 1.5 s to open but is prepared only 1 s ahead, so it begins at 101.5 s."""
    stage = Stage(Reader("a", count=25), Reader("b", count=50, opens_s=1.5))
    stage.show.step()
    stage.advance(2.0)
    assert position(stage) == ("b", 1, 1)
    assert stage.session.stats.percentile_ms("change", 100) == pytest.approx(500, abs=20)


def test_times_go_on_from_the_end_of_the_medium_before() -> None:
    """a ends at 101.00 s, noticed at 101.015 s: b's frames are still due at 101.00, 101.04, …."""
    stage = Stage(Reader("a", count=25), Reader("b", count=50))
    stage.show.step()
    stage.advance(0.99)
    stage.clock.now = 101.015
    stage.show.step()
    playback = stage.session.playback
    assert playback is not None
    assert playback.media_s == pytest.approx(0.015)
    assert stage.session.stats.percentile_ms("change", 100) == pytest.approx(15)


def test_a_medium_that_was_opened_before_its_turn_is_left_for_another() -> None:
    stage = playing(Reader("a", count=100), Reader("b", count=50), Reader("c", count=50))
    stage.advance(3.0)
    assert stage.begun == ["a", "b"]
    stage.commands.set("playlist-pos", 2)
    stage.advance(0.1)
    assert stage.readers["b"].closed
    assert position(stage) == ("c", 2, 2)


@pytest.mark.parametrize("wish", ["playlist-next", "loadfile"])
def test_the_last_wish_counts(wish: str) -> None:
    stage = playing(Reader("a", count=1000), Reader("b", opens_s=SLOW_S), Reader("c", count=1000, opens_s=SLOW_S))
    for name in "bc":
        stage.commands.run(wish, *([name] if wish == "loadfile" else []))
        stage.advance(0.1)
    assert stage.readers["b"].closed
    stage.advance(HURRY_S + SLOW_S)
    assert stage.commands.get("path") == "c"


def test_of_the_wishes_of_one_loop_only_the_last_is_opened_and_of_a_hurry_few() -> None:
    stage = playing(Reader("a", count=1000), *(Reader(name, opens_s=SLOW_S) for name in "bcde"))
    stage.advance(1.0)
    for name in "bcd":
        stage.commands.run("loadfile", name)
    stage.advance(0.01)
    assert stage.begun == ["a", "d"]
    for _ in range(10):
        stage.commands.run("loadfile", "e")
        stage.advance(0.01)
    assert len(stage.begun) <= 3
    stage.advance(HURRY_S + SLOW_S)
    assert stage.commands.get("path") == "e"


def test_a_wish_that_fails_gives_way_to_the_one_before(capsys: pytest.CaptureFixture[str]) -> None:
    stage = playing(Reader("a", count=1000), Reader("b", count=1000, opens_s=SLOW_S))
    broken = Reader("broken", opens_s=0.5, error="broken: no video")
    stage.readers["broken"] = broken
    stage.commands.run("loadfile", "b")
    stage.commands.run("loadfile", "broken")
    assert stage.commands.get("playlist") == ["broken"]
    stage.advance(1.0)
    assert stage.commands.get("playlist") == ["b"]
    stage.advance(SLOW_S)
    assert stage.commands.get("path") == "b"
    stage.commands.run("loadfile", "broken")
    stage.advance(1.0)
    assert (position(stage), stage.commands.get("playlist")) == (("b", 0, 0), ["b"])
    assert capsys.readouterr().err == 2 * "broken: no video\n"
    assert not stage.session.done


def test_the_next_medium_is_passed_over_towards_the_wished_side() -> None:
    media = [
        Reader("a", count=1000),
        Reader("x", error="x: gone"),
        Reader("y", error="y: gone"),
        Reader("b", count=1000),
    ]
    stage = playing(*media)
    stage.press(">")
    stage.advance(0.2)
    assert position(stage) == ("b", 3, 3)
    stage.press("<")
    stage.advance(0.2)
    assert position(stage) == ("a", 0, 0)
    assert stage.session.stats.notices == ["x: gone", "y: gone", "y: gone", "x: gone"]


@pytest.mark.parametrize("loop_list", [False, True])
def test_going_on_to_nothing_that_plays_leaves_what_plays(loop_list: bool) -> None:
    stage = playing(Reader("a", count=1000), Reader("x", error="x: gone"), loop_list=loop_list)
    for _ in range(3):
        stage.press(">")
        stage.advance(0.2)
        assert position(stage) == ("a", 0, 0)
    assert not stage.session.done
    assert stage.screen.uploaded == list(range(len(stage.screen.uploaded)))


def test_a_list_that_fails_as_a_whole_ends_a_show_with_its_error() -> None:
    stage = Stage(Reader("x", error="x: gone"), Reader("y", error="y: gone", opens_s=SLOW_S))
    with pytest.raises(InputError, match="y: gone"):
        run(stage)
    assert stage.session.stats.notices == ["x: gone"]


@pytest.mark.parametrize(
    ("media", "ends_well"),
    [
        ([Reader("x", error="x: gone"), Reader("a", count=5)], True),
        ([Reader("a", count=5), Reader("x", error="x: gone")], False),  # the show ends because x could not be played
        ([Reader("a", count=5, fails_at=3)], False),
        ([Reader("a", count=5, fails_at=3), Reader("b", count=5)], True),
    ],
)
def test_a_show_whose_last_medium_fails_does_not_end_well(media: list[Reader], ends_well: bool) -> None:
    stage = Stage(*media)
    if ends_well:
        run(stage)
    else:
        with pytest.raises(InputError, match=r"x: gone|a: broken"):
            run(stage)


def run(stage: Stage) -> None:
    """Play to the end on the simulated clock, as Session.run does."""
    screen = stage.screen

    def poll(timeout_s: float) -> list[str]:
        stage.clock.now += 0.01
        return []

    screen.poll = poll  # type: ignore[method-assign]
    stage.show.run()


def test_a_lasting_show_tries_again_later_and_later_and_plays_what_has_come_back(
    capsys: pytest.CaptureFixture[str],
) -> None:
    stage = Stage(Reader("x", error="x: gone"), Reader("y", error="y: gone"), lasting=True)
    tried_s: list[float] = []
    for _ in range(3000):
        stage.advance(0.05)
        tried_s += [stage.clock.now] * (stage.begun.count("x") - 1 - len(tried_s))
    waits = [after - before for before, after in pairwise(tried_s)]
    expected = [min(RETRY_S * 2**n, LONGEST_RETRY_S) for n in range(1, 1 + len(waits))]
    assert len(waits) > 6
    assert waits == pytest.approx(expected, abs=0.2)  # in steps of the simulated clock
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["x: gone", "y: gone; trying again after 1, 2, 4 … 30 s"]  # once, and not once per round
    found = facts(stage.session)
    assert (found["media"], found["skipped"], found["notices"]) == (2, 2, 2)
    assert not stage.session.done
    stage.readers["x"].error, stage.readers["x"].count = None, 1000
    stage.advance(LONGEST_RETRY_S + 0.1)
    assert stage.commands.get("path") == "x"
    assert facts(stage.session)["skipped"] == 1


def test_a_fault_that_returns_after_a_whole_play_is_reported_again(capsys: pytest.CaptureFixture[str]) -> None:
    stage = Stage(Reader("x", error="x: gone"), Reader("y"), loop_list=True)
    stage.advance(7.0)  # y plays three times in two seconds each
    assert capsys.readouterr().err.splitlines() == ["x: gone"]
    stage.readers["x"].error = None
    stage.advance(5.0)
    assert facts(stage.session)["skipped"] == 0
    stage.readers["x"].error = "x: gone"
    stage.advance(5.0)
    assert capsys.readouterr().err.splitlines() == ["x: gone"]


@pytest.mark.parametrize("kind", [{"loop_file": True}, {"loop_list": True}, {"lasting": True}])
def test_what_makes_a_show_last(kind: dict[str, object]) -> None:
    stage = Stage(Reader("x", error="x: gone"), **kind)  # type: ignore[arg-type]
    stage.advance(5.0)
    assert not stage.session.done


def test_the_last_frame_stays_and_a_wish_is_met_at_once_while_a_list_is_waited_for() -> None:
    stage = playing(Reader("a", count=5), Reader("x", error="x: gone"), Reader("c", count=1000), loop_list=True)
    stage.session.playlist.media.pop()
    stage.readers["a"].error = "a: gone"
    stage.advance(10.0)
    assert stage.screen.uploaded == list(range(5))
    assert not any(black for _, _, black in stage.screen.shown[1:])
    stage.commands.run("loadfile", "c", "append")
    stage.advance(0.1)
    assert stage.commands.get("path") == "c"


def test_a_medium_that_breaks_off_at_once_is_not_tried_without_end() -> None:
    stage = Stage(Reader("a", count=500, fails_at=1), loop_file=True)
    stage.advance(60.0)
    assert 4 <= len(stage.begun) <= 7  # after 1, 2, 4, 8, 16 and 30 s


def test_the_lines_of_months_take_a_bounded_room() -> None:
    stage = Stage(Reader("x", error="x: gone"), Reader("a", count=2), loop_list=True)
    for _ in range(MOST_NOTICES + 10):
        stage.session.notice("x: gone")
    assert len(stage.session.stats.notices) == MOST_NOTICES


def test_a_medium_that_breaks_off_late_is_tried_again_soon() -> None:
    stage = Stage(Reader("a", count=500, fails_at=200), loop_file=True)
    stage.advance(60.0)
    assert len(stage.begun) == pytest.approx(60 / (8 + RETRY_S), abs=1.5)


def test_a_failed_wish_while_nothing_plays_goes_back_to_waiting() -> None:
    stage = Stage(Reader("x", error="x: gone"), Reader("y", error="y: gone"), lasting=True)
    stage.advance(0.5)
    stage.commands.run("loadfile", "y")
    stage.advance(5.0)
    assert stage.commands.get("playlist") == ["x", "y"]
    stage.readers["x"].error = None
    stage.advance(10.0)
    assert stage.commands.get("path") == "x"


def test_media_that_may_not_be_named_are_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "inside.mkv").write_bytes(b"x")
    (tmp_path / "empty").mkdir()
    media = Media(Border((str(tmp_path),)))
    stage = Stage(Reader("a", count=1000))
    stage.session.programme.opener = media
    for name, why in {
        "lavfi:testsrc": "only the command line may name devices and filters",
        "udp://127.0.0.1:9": "add --allow-live",
        "/etc/passwd": "below its folder or a --media-root only",
        str(tmp_path / "gone.mkv"): "no such file",
        str(tmp_path / "empty"): "a folder without films and pictures",
        str(tmp_path.parent): "below its folder or a --media-root only",
        "": "no file has such a name",
        "a\0b": "no file has such a name",
        "x" * 5000: "no file has such a name",
        "\ud800": "no file has such a name",
    }.items():
        for how in ("replace", "append"):
            with pytest.raises(CommandError, match=why):
                stage.commands.run("loadfile", name, how)
    assert stage.commands.get("playlist") == ["a"]
    stage.commands.run("loadfile", str(tmp_path / "inside.mkv"), "append")
    stage.commands.run("loadfile", str(tmp_path), "append")
    assert stage.commands.get("playlist") == ["a", *[str(tmp_path / "inside.mkv")] * 2]


def advance_until(stage: Stage, condition: Callable[[], bool]) -> None:
    """Advance the simulated clock while a real thread works."""
    for _ in range(3000):
        if condition():
            return
        stage.advance(0.05)
        time.sleep(0.01)
    raise AssertionError


def test_a_list_on_a_disk_that_does_not_answer_stops_nothing(tmp_path: Path) -> None:
    """A function that waits replaces the disk. The playlist is skipped after its time limit."""
    answer = threading.Event()
    stage = Stage(Reader("a", count=50_000))

    def find(medium: Medium) -> list[Medium]:
        answer.wait()
        return [Medium("b")]

    stage.find = find  # type: ignore[method-assign]
    stage.readers["b"] = Reader("b", count=1000)
    stage.advance(0.1)
    stage.commands.run("loadfile", "list.txt")
    stage.advance(LIST_S - 1)
    assert stage.commands.get("path") == "a"
    stage.advance(2)
    assert stage.session.stats.notices == [f"list.txt: not read within {LIST_S:g} s; copy it to a local disk"]
    stage.commands.run("loadfile", "list.txt")
    answer.set()
    advance_until(stage, lambda: stage.commands.get("path") == "b")


def test_a_dead_disk_holds_a_few_threads_and_no_more() -> None:
    answer, before = threading.Event(), threading.active_count()
    looks = [LookUp(answer.wait) for _ in range(3 * MOST_WAITING)]
    assert threading.active_count() - before <= MOST_WAITING
    assert not any(look.result() for look in looks)
    answer.set()
    assert sum(look.result(1.0) is True for look in looks[:MOST_WAITING]) == MOST_WAITING


def test_a_list_that_was_not_there_at_the_start_is_read_when_it_is(tmp_path: Path) -> None:
    listed = tmp_path / "list.m3u"
    stage = Stage(Reader(str(listed)), lasting=True)
    stage.readers = {str(tmp_path / name): Reader(str(tmp_path / name), count=1000) for name in "ab"}
    advance_until(stage, lambda: bool(stage.session.stats.notices))
    assert "no such file" in stage.session.stats.notices[0]
    (tmp_path / "new").write_text("a\nb\n")
    os.rename(tmp_path / "new", listed)
    advance_until(stage, lambda: stage.session.playback is not None)
    assert stage.commands.get("path") == str(tmp_path / "a")
    assert stage.commands.get("playlist") == [str(tmp_path / name) for name in "ab"]


def test_a_list_of_many_media_is_refused_as_a_whole() -> None:
    stage = playing(Reader("a", count=1000))
    stage.find = lambda medium: [Medium("a")] * 9_000  # type: ignore[method-assign]
    stage.commands.run("loadfile", "a", "append")
    with pytest.raises(CommandError, match="18001 media, a list holds 10000"):
        stage.commands.run("loadfile", "a", "append")
    assert len(stage.commands.get("playlist")) == 9_001
