"""Playback without a window: the time of each frame, and the next medium. Clock, display and reader are stand-ins.

Real readers, renderers and windows are tested in test_video.py, gl/ and test_player.py. Here, time is the input.
"""

import gc
from pathlib import Path

import numpy as np
import pytest

from counterlight.media.medium import Medium
from counterlight.show.registry import CommandError
from counterlight.show.stats import Stats
from tests.stage import Reader, Stage


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_each_frame_is_shown_at_its_time(stage: Stage) -> None:
    stage.show.step()
    assert stage.screen.uploaded == [0]
    stage.advance(0.39)
    assert stage.screen.uploaded == list(range(10))
    assert stage.session.stats.dropped == 0
    assert stage.screen.title.startswith("clip")


def test_frames_that_were_overtaken_are_dropped_and_counted(stage: Stage) -> None:
    stage.show.step()
    stage.clock.now += 0.21  # five frames later
    stage.show.step()
    assert stage.screen.uploaded == [0, 5]
    assert stage.session.stats.dropped == 4
    assert sorted(stage.reader.released) == [0, 1, 2, 3, 4, 5]


def test_lateness_and_judder_are_those_of_the_clock(stage: Stage) -> None:
    """Frames due every 40 ms are shown 3, 13 and 70 ms late. Judder is the difference of these delays."""
    stage.show.step()
    for now in (100.043, 100.093, 100.190):
        stage.clock.now = now
        stage.show.step()
    stats = stage.session.stats
    assert stage.screen.uploaded == [0, 1, 2, 4]
    assert stats.late_counts == (1, 0, 1, 0, 1, 1, 0, 0)
    assert stats.median_ms("late") == pytest.approx(np.median([0, 3, 13, 30]))
    assert stats.percentile_ms("judder", 100) == pytest.approx(17)
    assert stats.frames_per_second == pytest.approx(3 / 0.19)
    assert sum(stats.to_dict()["late_frames"].values()) == 4


def test_pause_holds_and_resumes_where_it_was(stage: Stage) -> None:
    stage.advance(0.2)
    assert stage.press("space") == "Pause: on"
    count = len(stage.screen.uploaded)
    stage.advance(10)
    assert len(stage.screen.uploaded) == count
    stage.press("p")
    stage.advance(0.2)
    assert stage.screen.uploaded == list(range(len(stage.screen.uploaded)))
    assert stage.session.stats.dropped == 0


def test_seeking_goes_from_the_current_position() -> None:
    stage = Stage(Reader(count=1000))
    stage.advance(0.4)
    assert stage.press("right") == "0:00:05 / 0:00:40 (13 %)"
    stage.advance(0.02)
    # at the previous position, within a frame or two
    assert stage.screen.uploaded[-1] == pytest.approx(25 * 5.4, abs=2)
    stage.press("left", "left")
    stage.advance(0.02)
    assert stage.screen.uploaded[-1] <= 1
    assert stage.session.stats.dropped == 0
    for words, frame in ((("50", "absolute-percent"), 500), (("7", "absolute"), 175), (("-2",), 125)):
        stage.commands.run("seek", *words)
        stage.show.step()
        assert stage.screen.uploaded[-1] == frame
    stage.commands.set("time-pos", 3)
    stage.show.step()
    assert stage.screen.uploaded[-1] == 75
    stage.press("up")
    assert stage.session.done  # this is past the end


def test_seeking_and_stepping_while_paused() -> None:
    stage = Stage(Reader(count=1000))
    stage.advance(0.1)
    stage.press("space", "right")
    assert stage.screen.uploaded[-1] >= 125
    count, here = len(stage.screen.uploaded), stage.screen.uploaded[-1]
    stage.advance(1)
    assert len(stage.screen.uploaded) == count
    stage.press(".", ".", ",", ",", ",")
    assert stage.screen.uploaded[count:] == [here + 1, here + 2, here + 1, here, here - 1]
    stage.press("space")
    stage.advance(0.1)
    assert stage.screen.uploaded[-1] == here + 1
    stage.press(".")
    assert stage.commands.get("pause")
    assert stage.screen.uploaded[-1] == here + 2


def test_speed_changes_the_rate_and_not_the_place() -> None:
    stage = Stage(Reader(count=1000))
    stage.advance(1.0)
    stage.commands.set("speed", 2)
    stage.advance(1.0)
    assert stage.screen.uploaded[-1] == pytest.approx(75, abs=1)
    stage.commands.set("speed", 0.5)
    stage.advance(1.0)
    assert stage.screen.uploaded[-1] == pytest.approx(87, abs=1)


def test_frames_that_come_too_late_are_said_once_with_what_to_change() -> None:
    stage = Stage(Reader(count=1000), Reader("other", count=1000), refine=16)
    stage.session.stats.add("decode", 0.002)
    for _ in range(500):  # more samples than the stage adds, which draws nothing
        stage.session.stats.add("gpu", 0.12)
    stage.advance(4.9, step=0.12)  # three frames pass per frame shown
    assert stage.session.stats.notices == []
    stage.advance(10, step=0.12)
    (line,) = stage.session.stats.notices
    assert line.startswith("not every frame can be shown in time (")
    assert "drawing takes 120 ms with 16 steps, a frame lasts 40; every 3rd frame is shown; take fewer steps" in line
    stage.press(">")
    stage.advance(4.9, step=0.04)
    assert len(stage.session.stats.notices) == 1
    stage.advance(20, step=0.04)  # in time again: the new medium is not blamed for the old medium's dropped frames
    assert len(stage.session.stats.notices) == 1


def test_the_a_b_loop_goes_back_at_b_until_it_is_cleared() -> None:
    stage = Stage(Reader(count=1000))
    stage.advance(1.0)
    assert stage.press("l").startswith("A-B loop from ")
    stage.advance(0.4)
    stage.press("l")
    a, b = (round(25 * stage.commands.get(f"ab-loop-{point}")) for point in "ab")
    assert (a, b) == (stage.screen.uploaded[a], stage.screen.uploaded[-1])
    assert b - a == 10
    stage.advance(2.0)
    assert set(stage.screen.uploaded[b + 1 :]) == set(range(a, b))
    assert stage.press("l") == "A-B loop: off"
    stage.advance(1.0)
    assert stage.screen.uploaded[-1] > b
    stage.commands.set("ab-loop-a", 39)
    stage.commands.set("ab-loop-b", 100)  # after the end, where the end serves as B
    stage.commands.run("seek", 39.5, "absolute")
    stage.advance(1.0)
    assert not stage.session.done
    assert 975 <= stage.screen.uploaded[-1] < 1000


def test_the_a_b_loop_runs_between_its_points_whichever_was_set_first() -> None:
    stage = Stage(Reader(count=1000))
    stage.advance(2.0)
    stage.press("l")
    stage.commands.run("seek", 1.0, "absolute")
    stage.advance(0.2)
    said = stage.press("l")
    b, a = (round(25 * stage.commands.get(f"ab-loop-{point}")) for point in "ab")
    assert a < b
    assert said == f"A-B loop {a / 25:.2f} to {b / 25:.2f} s"
    begun = len(stage.screen.uploaded)
    stage.advance(3.0)
    assert set(stage.screen.uploaded[begun:]) == set(range(a, b))


@pytest.mark.parametrize("seamless", [False, True])
def test_looping_begins_and_ends_with_its_key(seamless: bool) -> None:
    stage = Stage(Reader(count=10), loop_file=seamless)
    if not seamless:
        assert stage.press("L") == "Loop file: on"
    stage.advance(1.5)
    assert not stage.session.done
    assert stage.screen.uploaded[:10] == list(range(10))
    assert len(stage.screen.uploaded) == pytest.approx(38, abs=3)
    assert stage.commands.get("time-pos") < 0.4
    stage.press("L")
    stage.advance(0.5)
    assert stage.session.done


def test_a_list_plays_on_and_pictures_last_as_long_as_asked() -> None:
    media = Reader("a", count=5), Reader("b", count=1, still=True), Reader("c", count=5)
    stage = Stage(*media, image_display_duration=1.0)
    stage.advance(0.3)
    assert stage.commands.get("path") == "b"
    assert media[0].closed
    stage.advance(0.5)
    stage.press("space")
    stage.advance(5)
    assert stage.commands.get("playlist-pos") == 1  # paused pictures wait
    stage.press("space")
    stage.advance(0.6)
    assert stage.commands.get("path") == "c"
    assert stage.press("<") == "2/3 b"
    assert stage.press("<") == "1/3 a"
    assert stage.press("<") == "no medium before this one"
    stage.press(">", ">")
    assert stage.press(">") == "no further medium in the list"
    stage.advance(0.5)
    assert stage.session.done
    assert stage.session.stats.frames == len(stage.screen.uploaded)


def test_media_that_fail_are_passed_over_and_named(capsys: pytest.CaptureFixture[str]) -> None:
    stage = Stage(Reader("a", count=5, fails_at=2), Reader("b", count=5))
    stage.session.playlist.media.insert(1, Medium("gone"))
    stage.advance(0.2)
    assert stage.commands.get("path") == "b"
    assert stage.session.stats.notices == ["a: broken", "gone: no such file"]
    assert capsys.readouterr().err == "a: broken\ngone: no such file\n"
    stage.advance(0.5)
    assert stage.session.done
    assert stage.session.programme.failure is None


def test_loadfile_keeps_what_plays_if_the_new_one_cannot(stage: Stage, tmp_path: Path) -> None:
    stage.readers["new"] = Reader("new")
    stage.advance(0.2)
    with pytest.raises(CommandError, match="gone: no such file"):
        stage.commands.run("loadfile", "gone")
    assert stage.commands.get("path") == "clip"
    listed = tmp_path / "list.txt"
    listed.write_text("x\ny\n")
    stage.commands.run("loadfile", str(listed), "append")
    assert stage.commands.get("playlist") == ["clip", str(tmp_path / "x"), str(tmp_path / "y")]
    stage.commands.run("loadfile", "new")
    assert stage.commands.get("playlist") == ["new"]
    stage.advance(0.1)
    assert stage.reader.closed
    assert stage.commands.get("path") == "new"


def test_collections_pass_over_what_was_there_before_the_show() -> None:
    stage, frozen = Stage(Reader(count=3)), []
    stage.screen.poll = lambda timeout_s: frozen.append(gc.get_freeze_count()) or [stage.advance(0.04)][:0]  # type: ignore[method-assign]
    stage.show.run()
    assert min(frozen) > 10_000  # numpy alone has this number of objects
    assert gc.get_freeze_count() == 0


def test_the_figures_of_the_last_ten_seconds_are_of_frames_that_missed_their_time() -> None:
    """Frames drawn 30 ms late are in time. Frames that were dropped during a standstill count for 10 s."""
    stage = Stage(Reader(count=10_000))
    stage.show.step()
    stage.clock.now += 0.03
    stage.advance(5.0, step=0.04)
    recent = stage.commands.get("recent")
    assert (recent["late"], recent["dropped"], recent["requested"]) == (0, 0, 25)
    assert recent["shown"] == pytest.approx(125, abs=2)
    assert recent["fps"] == pytest.approx(25, rel=0.02)
    stage.clock.now += 0.4
    stage.show.step()
    assert stage.commands.get("recent")["dropped"] in (9, 10)
    stage.advance(10.1, step=0.04)
    assert stage.commands.get("recent")["dropped"] == 0
    stage.commands.set("pause", True)
    assert stage.commands.get("recent")["requested"] == 0


def test_a_frame_is_late_once_the_next_one_is_due() -> None:
    stats = Stats()
    for late_s in (0.0, 0.039, 0.041):
        stats.shown(100 + late_s, 100, 0.04)
    assert stats.recent(101) == {"seconds": 10, "shown": 3, "late": 1, "dropped": 0}


def test_events_have_the_times_at_which_they_happened(monkeypatch: pytest.MonkeyPatch) -> None:
    stage = Stage()
    for at in (1000.0, 1060.5):
        monkeypatch.setattr("time.time", lambda at=at: at)
        stage.session.notice("the decoder stumbled")
    monkeypatch.setattr("time.time", lambda: 5000.0)
    events = [{"time": at, "text": "the decoder stumbled"} for at in (1000.0, 1060.5)]
    assert stage.commands.get("events") == events


def test_steps_are_those_of_the_picture_on_the_screen() -> None:
    stage = Stage(refine=4)
    assert stage.commands.get("steps") == 0
    stage.advance(0.1)
    assert stage.commands.get("steps") == 4
    stage.commands.set("compensation", False)
    stage.advance(0.1)
    assert stage.commands.get("steps") == 0
