"""Disk full: every command, on file systems of every size that is too small, says so in one line and loses nothing."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.picture_files import read_picture
from counterlight.reading import read_toml
from counterlight.show.registry import CommandError
from counterlight.tools import build_correction_map
from tests.brackets import CURVES, random_scene, write_bracket
from tests.faults import Runner, can_mount, no_file_above, small_disk
from tests.programs import CLIP, ROOT
from tests.rooms import write_blurred_room
from tests.stage import Stage

SCENE = ROOT / "calib_data" / "scenes" / "wall.toml"
PAGE = 4096  # what a tmpfs gives room in
TOO_SMALL = (0.0, 0.5, 0.9, 1.0)  # of what the output takes; the last leaves none for the lock
COMMANDS = {
    "relight.png": "tools.relight ROOM -o OUT/o.png",
    "relight.exr": "tools.relight ROOM -o OUT/o.exr",
    "compensate": "tools.compensate_image ROOM PICTURE --solver map -o OUT/o.png",
    "merge": "tools.merge_exposures SHOTS --times 1 2 4 8 --response linear -o OUT/o.exr",
    "build": "tools.build_correction_map OUT/room --regularize 0.2",
    "simulate": "tools.simulate_transport SCENE -o OUT/made --camera 24x18 --projector 20x15",
    "acquire": "tools.acquire_transport --camera simulated:ROOM --scheme graycode -o OUT/made --no-preflight",
    "join": "tools.join_projectors ROOM ROOM -o OUT/made",
    "play.png": "app ROOM CLIP --frames 2 --output OUT/o.png",
    "play.exr": "app ROOM CLIP --frames 2 --output OUT/o.exr",
    "play.mp4": "app ROOM CLIP --frames 8 --output OUT/o.mp4",
    "play.webm": "app ROOM CLIP --frames 8 --output OUT/o.webm",
    "play.mkv": "app ROOM CLIP --frames 8 --output OUT/o.mkv",
    "play%d.png": "app ROOM CLIP --frames 8 --output OUT/f%02d.png",
}


@pytest.fixture(scope="module")
def runner() -> Iterator[Runner]:
    with Runner() as runner:
        yield runner


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("full") / "room"
    write_blurred_room(folder, np.random.default_rng(3))
    assert build_correction_map.main([str(folder), "--regularize", "0.1"]) == 0
    rng = np.random.default_rng(4)
    cv2.imwrite(str(folder.parent / "picture.png"), rng.integers(0, 256, (30, 40, 3), np.uint8))
    write_bracket(folder.parent / "shots", random_scene(rng, (48, 64, 3)), [1, 2, 4, 8], CURVES["linear"])
    return folder


def words_of(command: str, out: Path, room: Path) -> tuple[str, list[str]]:
    """Function and arguments of a command; its inputs are made beside the room."""
    here = room.parent
    names = {"ROOM": room, "CLIP": CLIP, "SCENE": SCENE, "PICTURE": here / "picture.png", "OUT": out}
    shots = [str(here / "shots" / f"shot{i:02}.png") for i in range(4)]
    module, *words = command.split()
    arguments = [part for word in words for part in (shots if word == "SHOTS" else [_named(word, names)])]
    return f"counterlight.{module}:main", [arguments]


def _named(word: str, names: dict[str, Path]) -> str:
    for name, path in names.items():
        word = word.replace(name, str(path))
    return word


def furnish(out: Path, room: Path) -> dict[str, bytes]:
    """What is there before: an output of every kind, and what the command builds on."""
    for name in ("o.png", "o.exr", "o.mp4", "o.webm", "o.mkv", "r.toml", "s.json", "f00.png", "f01.png"):
        (out / name).write_text(f"old {name}")
    shutil.copytree(room, out / "room")
    return contents(out)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def room_for(files: dict[str, bytes]) -> int:
    """Bytes of the pages that files fill."""
    return sum(-(-len(content) // PAGE) * PAGE for content in files.values())


@pytest.mark.skipif(not can_mount(), reason="mounting a small file system needs the right to")
@pytest.mark.parametrize("name", COMMANDS)
def test_on_a_disk_that_is_too_small_nothing_is_lost(name: str, room: Path, tmp_path: Path, runner: Runner) -> None:
    """From no room at all to enough of it; the old outputs stay as they are until the new ones are whole."""
    large, small = tmp_path / "large", tmp_path / "small"
    large.mkdir()
    small.mkdir()
    before = furnish(large, room)
    done = runner.run(*words_of(COMMANDS[name], large, room))
    assert done.code == 0, done.words
    made = contents(large)
    new = {key: content for key, content in made.items() if before.get(key) != content}
    for share in (*TOO_SMALL, 3.0):
        size = room_for(before) + max(int(share * room_for(new)) // PAGE, 1) * PAGE
        with small_disk(small, size):
            furnish(small, room)
            run = runner.run(*words_of(COMMANDS[name], small, room))
            after = contents(small)
            if share not in TOO_SMALL:
                assert run.code == 0, run.words
                assert after.keys() == made.keys()
                continue
            assert run.code == 2, run.words
            (line,) = [line for line in run.words.splitlines() if "error" in line]
            assert "cannot be written (No space left on device)" in line
            assert {key: after.get(key) for key in before} == before
            assert [key for key in after.keys() - before.keys() if not is_whole(small, key)] == []


def is_whole(folder: Path, name: str) -> bool:
    """What stays of an acquisition: captures for the run that goes on, and its room when the report found no place."""
    path = folder / name
    if name.startswith("made.captures/captures/"):
        return read_picture(path).size > 0
    if name.startswith("made/"):
        return bool(calibration.read(folder / "made").calibration.name)
    return name == "made.captures/session.toml" and read_toml(path, "") != {}


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
