"""Playlists edited during playback by mpv's commands, on a simulated clock, and folders that may be browsed."""

from pathlib import Path

import pytest

from counterlight.media.medium import Border
from counterlight.show.media import Media
from counterlight.show.registry import CommandError
from tests.stage import Reader, Stage


@pytest.fixture
def stage() -> Stage:
    """Return a stage with media a, b, c and d; b plays."""
    stage = Stage(*(Reader(name, count=1000) for name in "abcd"))
    stage.advance(0.1)
    stage.commands.set("playlist-pos", 1)
    stage.advance(0.1)
    return stage


def state(stage: Stage) -> tuple[str, str, int, int]:
    """Return the list, the playing medium, and the two positions."""
    get = stage.commands.get
    return "".join(get("playlist")), get("path"), get("playlist-playing-pos"), get("playlist-pos")


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (("playlist-remove", 0), ("bcd", "b", 0, 0)),
        (("playlist-remove", "3"), ("abc", "b", 1, 1)),
        (("playlist-remove", 1), ("acd", "c", 1, 1)),
        (("playlist-remove", "current"), ("acd", "c", 1, 1)),
        (("playlist-clear",), ("b", "b", 0, 0)),
        (("playlist-move", 1, 3), ("acbd", "b", 2, 2)),  # as in mpv, the entry moves before the entry that was at 3
        (("playlist-move", 1, 4), ("acdb", "b", 3, 3)),
        (("playlist-move", 3, 0), ("dabc", "b", 2, 2)),
        (("playlist-move", 0, 0), ("abcd", "b", 1, 1)),
        (("loadfile", "c", "insert-next"), ("abccd", "b", 1, 1)),
        (("loadfile", "c", "insert-next-play"), ("abccd", "b", 1, 1)),
        (("loadfile", "c", "append-play"), ("abcdc", "b", 1, 1)),
    ],
)
def test_what_plays_stays_where_it_is_in_the_list(
    stage: Stage, command: tuple[object, ...], expected: tuple[str, str, int, int]
) -> None:
    stage.commands.run(str(command[0]), *command[1:])
    stage.advance(0.1)
    assert state(stage) == expected


def test_a_shuffled_list_holds_the_same_and_what_plays_goes_on(stage: Stage) -> None:
    orders = set()
    for _ in range(20):
        stage.commands.run("playlist-shuffle")
        stage.advance(0.01)
        media, path, on, position = state(stage)
        assert (sorted(media), path, on, media[on]) == (list("abcd"), "b", position, "b")
        orders.add(media)
    assert len(orders) > 2  # twenty draws from 24 possible orders


def test_what_was_opened_before_its_turn_gives_way_to_what_is_inserted() -> None:
    stage = Stage(*(Reader(name, count=100) for name in "abc"))
    stage.advance(1.0)
    assert stage.begun == ["a", "b"]
    stage.commands.run("loadfile", "c", "insert-next")
    stage.advance(3.5)
    assert stage.begun == ["a", "b", "c", "b"]
    assert state(stage) == ("acbc", "c", 1, 1)


def test_removing_the_last_medium_while_it_plays_ends_the_list(stage: Stage) -> None:
    stage.screen.fullscreen = True
    stage.commands.set("playlist-pos", 3)
    stage.advance(0.1)
    stage.commands.run("playlist-remove", "current")
    stage.advance(0.1)
    assert stage.commands.get("eof-reached")
    stage.commands.run("loadfile", "a", "append-play")
    stage.advance(0.1)
    assert state(stage) == ("abca", "a", 3, 3)


@pytest.mark.parametrize(
    ("command", "why"),
    [
        (("playlist-remove", 4), "expected a position from 0 to 3, found 4"),
        (("playlist-remove", "b"), "expected a position from 0 to 3, found 'b'"),
        (("playlist-move", 0, 5), "expected a position from 0 to 4, found 5"),
        (("playlist-move", -1, 0), "expected a position from 0 to 3, found -1"),
    ],
)
def test_positions_that_are_not_in_the_list_are_refused(stage: Stage, command: tuple[object, ...], why: str) -> None:
    before = state(stage)
    with pytest.raises(CommandError, match=why):
        stage.commands.run(str(command[0]), *command[1:])
    stage.commands.run("playlist-clear")
    with pytest.raises(CommandError, match="b: the only medium of the list"):
        stage.commands.run("playlist-remove", 0)
    assert before == ("abcd", "b", 1, 1)


def test_folders_below_the_roots_are_listed_and_no_others(tmp_path: Path) -> None:
    root = tmp_path / "media"
    (root / "inner").mkdir(parents=True)
    for name in ("b.mkv", "a.mkv", ".hidden"):
        (root / name).write_bytes(b"x")
    (root / "out").symlink_to(tmp_path)
    media = Media(Border((str(root),)))
    assert media.browse("") == {"folders": [str(root)], "files": []}
    found = media.browse(str(root))
    assert found["files"] == [str(root / "a.mkv"), str(root / "b.mkv")]
    assert found["folders"] == [str(root / "inner"), str(root / "out")]
    stage = Stage(Reader("a"))
    stage.session.programme.opener = media
    for folder, why in ((tmp_path, "below its folder"), (root / "out", "below its folder"), (root / "none", "No such")):
        with pytest.raises(CommandError, match=why):
            stage.commands.run("browse", str(folder))
