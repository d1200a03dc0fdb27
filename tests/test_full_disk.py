"""Full disk: every command, on file systems of every insufficient size, fails in one line and loses nothing."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from counterlight.files.picture_files import read_picture
from counterlight.show.registry import CommandError
from tests.faults import Runner, can_mount, no_file_above, small_disk
from tests.stage import Stage
from tests.writing_commands import COMMANDS, PAGE, contents, furnish, is_whole, room_for, words_of, write_inputs

TOO_SMALL = 0.0, 0.9, 0.5, 1.0  # free space over the output's size; the last value leaves no space for the lock


@pytest.fixture(scope="module")
def runner() -> Iterator[Runner]:
    with Runner() as runner:
        yield runner


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("full") / "room"
    write_inputs(folder)
    return folder


@pytest.mark.skipif(not can_mount(), reason="mounting a small file system needs the right to")
@pytest.mark.parametrize(("name", "too_small"), [*zip(COMMANDS, itertools.cycle(TOO_SMALL))])
def test_on_a_disk_that_is_too_small_nothing_is_lost(
    name: str, too_small: float, room: Path, tmp_path: Path, runner: Runner
) -> None:
    """An insufficient size, then enough; the old outputs stay unchanged until the new outputs are complete.

    `make fuzz` tries random sizes for every command.
    """
    large, small = tmp_path / "large", tmp_path / "small"
    large.mkdir()
    small.mkdir()
    before = furnish(large, room)
    done = runner.run(*words_of(COMMANDS[name], large, room))
    assert done.code == 0, done.words
    made = contents(large)
    new = {key: content for key, content in made.items() if before.get(key) != content}
    for share in (too_small, 3.0):
        size = room_for(before) + max(int(share * room_for(new)) // PAGE, 1) * PAGE
        with small_disk(small, size):
            furnish(small, room)
            run = runner.run(*words_of(COMMANDS[name], small, room))
            after = contents(small)
            if share != too_small:
                assert run.code == 0, run.words
                assert after.keys() == made.keys()
                continue
            assert run.code == 2, run.words
            (line,) = [line for line in run.words.splitlines() if "error" in line]
            assert "cannot be written (No space left on device)" in line
            assert {key: after.get(key) for key in before} == before
            assert [key for key in after.keys() - before.keys() if not is_whole(small, key)] == []


def test_a_screenshot_that_finds_no_room_is_not_called_a_success(tmp_path: Path, rng: np.random.Generator) -> None:
    stage = Stage(screenshots=tmp_path)
    picture = rng.integers(0, 256, (30, 40, 3), np.uint8)
    stage.screen.encoded = lambda: picture  # type: ignore[attr-defined]
    stage.advance(0.1)
    with no_file_above(1000), pytest.raises(CommandError, match=r"\.png: cannot be written \(File too large\)"):
        stage.commands.run("screenshot")
    assert list(tmp_path.iterdir()) == []
    saved = Path(str(stage.commands.run("screenshot")))
    np.testing.assert_array_equal(read_picture(saved), picture)
