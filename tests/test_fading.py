"""The end of a show, fades and crossfades, on a fake clock; gl/test_fading.py checks the pictures."""

import pytest

from tests.stage import Reader, Stage


def fullscreen(*readers: Reader, **options: object) -> Stage:
    stage = Stage(*readers, **options)  # type: ignore[arg-type]
    stage.screen.fullscreen = True
    return stage


def is_black(stage: Stage) -> bool:
    return stage.screen.shown[-1][2]


@pytest.mark.parametrize(
    ("keep", "full", "ends", "black"),
    [
        ("auto", False, True, False),
        ("auto", True, False, True),
        ("no", True, True, False),
        ("yes", True, False, False),
        ("black", False, False, True),
    ],
)
def test_the_end_of_a_show_is_what_keep_open_says(keep: str, full: bool, ends: bool, black: bool) -> None:
    stage = Stage(Reader(count=25), keep_open=keep)
    stage.screen.fullscreen = full
    stage.advance(3.0)
    assert (stage.session.done, is_black(stage), stage.commands.get("eof-reached")) == (ends, black, not ends)
    assert stage.screen.uploaded == list(range(25))


@pytest.mark.parametrize("keep", ["yes", "black"])
def test_from_a_held_end_one_can_go_back_or_on(keep: str) -> None:
    stage = Stage(Reader("a", count=25), Reader("b", count=1000), keep_open=keep)
    stage.session.playlist.media.pop()
    stage.advance(3.0)
    assert (stage.commands.get("eof-reached"), stage.commands.get("pause")) == (True, True)
    stage.commands.run("seek", "-0.5")
    stage.commands.set("pause", False)
    stage.advance(0.3)
    assert not stage.commands.get("eof-reached")
    assert not is_black(stage)
    assert 11 <= stage.screen.uploaded[-1] < 25
    stage.advance(1.0)
    assert stage.commands.get("eof-reached")
    stage.commands.run("loadfile", "b")
    stage.advance(0.5)
    assert (stage.commands.get("path"), stage.commands.get("eof-reached"), is_black(stage)) == ("b", False, False)


def test_always_holds_every_medium() -> None:
    stage = Stage(Reader("a", count=25), Reader("b", count=25), keep_open="always")
    stage.advance(3.0)
    assert stage.commands.get("path") == "a"
    stage.commands.run("playlist-next")
    stage.advance(0.1)
    assert stage.commands.get("path") == "b"


def test_a_last_medium_that_fails_leaves_black_on_a_filled_screen() -> None:
    stage = fullscreen(Reader("a", count=25), Reader("x", error="x: gone"))
    stage.advance(60.0)
    assert not stage.session.done
    assert is_black(stage)
    assert stage.session.stats.notices == ["x: gone"]  # once: the list has ended, and nothing follows
    assert stage.begun == ["a", "x"]


def test_light_fades_at_the_start_at_the_end_and_for_blackout() -> None:
    stage = Stage(Reader(count=250), fade_s=1.0)
    stage.show.step()
    assert is_black(stage)
    stage.advance(0.5)
    assert stage.screen.fades[-1][0] == pytest.approx(0.5, abs=0.02)
    stage.advance(2.0)
    assert stage.screen.fades[-1] == (1.0, 0.0)
    drawn = len(stage.screen.steps)
    stage.commands.set("pause", True)
    stage.commands.set("blackout", True)
    stage.advance(0.75)
    assert stage.screen.fades[-1][0] == pytest.approx(0.25, abs=0.02)
    assert not is_black(stage)
    assert len(stage.screen.steps) > drawn + 50  # a still picture is drawn again
    stage.advance(0.5)
    assert is_black(stage)
    stage.commands.set("blackout", False)
    stage.commands.set("pause", False)
    stage.commands.run("seek", "7.5", "absolute")
    stage.advance(2.0)
    assert stage.screen.fades[-1][0] == pytest.approx(0.5, abs=0.06)
    stage.advance(0.6)
    assert stage.session.done


def test_quitting_fades_and_a_second_time_does_not_wait() -> None:
    for twice in (False, True):
        stage = Stage(Reader(count=250), fade_s=1.0)
        stage.advance(2.0)
        stage.press("q", *["q"] * twice)
        assert stage.session.done is twice
        stage.advance(0.9)
        assert stage.session.done is twice
        stage.advance(0.2)
        assert stage.session.done


def test_two_media_play_at_once_while_one_fades_into_the_other() -> None:
    stage = Stage(Reader("a", count=100), Reader("b", count=100), crossfade_s=1.0)
    stage.advance(2.9)
    assert (stage.commands.get("path"), stage.screen.uploaded_before) == ("a", [])
    stage.advance(0.6)  # the last second of a, and 0.5 s of b
    assert stage.commands.get("path") == "b"
    assert stage.screen.fades[-1] == (1.0, pytest.approx(0.5, abs=0.06))
    assert stage.screen.uploaded_before == list(range(76, 76 + len(stage.screen.uploaded_before)))
    assert not stage.readers["a"].closed
    stage.advance(0.6)
    assert stage.screen.fades[-1] == (1.0, 0.0)
    assert stage.screen.uploaded_before == list(range(76, 100))
    assert stage.readers["a"].closed
    assert sorted(stage.readers["a"].released) == list(range(100))


def test_a_wish_fades_too_and_ends_a_fade_that_goes_on() -> None:
    stage = Stage(Reader("a", count=1000), Reader("b", count=1000), Reader("c", count=1000), crossfade_s=2.0)
    stage.advance(1.0)
    for name, before in (("b", "a"), ("c", "b")):
        stage.commands.run("playlist-next")
        stage.advance(0.5)
        assert (stage.commands.get("path"), stage.readers[before].closed) == (name, False)
    assert stage.readers["a"].closed


def test_media_shorter_than_the_crossfade_all_play() -> None:
    stage = Stage(*(Reader(name, count=10) for name in "abc"), crossfade_s=5.0)
    stage.advance(3.0)
    assert stage.begun == ["a", "b", "c"]
    assert stage.session.done
