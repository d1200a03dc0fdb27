"""Writing is complete or has no effect: kills, refusals and full disks at every step, and several processes at once."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.maps import room_maps as maps
from counterlight.tools.shipped import CLIP
from counterlight.writing.stage import SUFFIX, finish
from tests import written
from tests.faults import KILL, REFUSE, Fault, Run, Runner, refused_here
from tests.programs import ROOT, fail, running

SCENE = ROOT / "calib_data" / "scenes" / "wall.toml"
KINDS: dict[str, tuple[str, str]] = {  # kind of output: its name on disk
    "file": ("file", "notes.txt"),
    "room": ("room", "room"),
    "maps": ("room_maps", "room"),
    "sequence": ("sequence", "frame%03d.png"),
}
STRIDES = {"room": 3, "maps": 3}  # kinds with many steps
Look = Callable[[str], int | None]


@pytest.fixture(scope="module")
def runner() -> Iterator[Runner]:
    with Runner() as runner:
        yield runner


class Place:
    """Folder into which generations of one kind of output are written."""

    def __init__(self, kind: str, folder: Path, runner: Runner) -> None:
        write, name = KINDS[kind]
        self.path, self._runner = str(folder / name), runner
        self._function, self.look = f"tests.written:write_{write}", getattr(written, f"{kind}_generation")
        self._write: Callable[[str, int], None] = getattr(written, f"write_{write}")
        self.folder = folder
        if kind == "maps":
            written.write_room(self.path, 0)

    def strike(self, generation: int, fault: Fault) -> Run:
        """Write a generation under a fault; a process that is killed is another process."""
        if fault.how == REFUSE:
            return refused_here(self._write, [self.path, generation], fault)
        return self._runner.run(self._function, [self.path, generation], fault)

    def write(self, generation: int) -> None:
        """Write a generation in this process, where nothing fails."""
        self._write(self.path, generation)

    def left_over(self) -> list[str]:
        return [str(path.relative_to(self.folder)) for path in self.folder.rglob(".*")]


@pytest.mark.parametrize("exchange", [True, False], ids=["exchange", "journal"])
@pytest.mark.parametrize("how", [KILL, REFUSE])
@pytest.mark.parametrize("kind", KINDS)
def test_struck_at_any_step_the_old_or_the_new_is_whole(
    kind: str, how: str, exchange: bool, tmp_path: Path, runner: Runner, rng: np.random.Generator
) -> None:
    """Each generation overwrites the previous generation and is struck at a later step.

    `make fuzz` strikes commands at every step. Then a reader comes, which may complete an interrupted write, or
    another writer.
    """
    place = Place(kind, tmp_path, runner)
    place.write(1)
    seen = set()
    for generation, at in enumerate(range(1, 1000, STRIDES.get(kind, 1)), 2):
        run = place.strike(generation, Fault(at, how, exchange=exchange))
        if not run.struck:
            assert run.code == 0, run.words
            break
        assert run.code in ((-9,) if how == KILL else (0, 2)), run.words
        assert len(run.words.splitlines()) <= 1
        assert kind != "sequence" or one_generation(tmp_path)
        if run.code == 2:  # the command has failed, so there is nothing to continue with
            assert place.left_over() == []
        if rng.integers(3) != 0:
            found = place.look(place.path)
            assert found == generation or (run.code != 0 and found == generation - 1), run
            seen.add(found == generation)
        place.write(generation)  # the next command that writes
        assert place.look(place.path) == generation
        assert place.left_over() == []
    else:
        pytest.fail("never ended")
    assert seen == {False, True}
    assert at > 10


def one_generation(folder: Path) -> bool:
    """Return whether the frames, before any repair, belong to one generation, and are complete if number 0 exists."""
    frames = {int(path.stem[-3:]): path for path in folder.glob("frame*.png")}
    generations = {written.frame_generation(path, number) for number, path in frames.items()}
    if 0 in frames:
        (generation,) = generations
        assert sorted(frames) == list(range(written.frames_of(generation)))
    return len(generations) <= 1


@pytest.mark.parametrize("exchange", [True, False], ids=["exchange", "journal"])
@pytest.mark.parametrize("kind", ["room", "sequence"])
def test_killed_at_the_first_time_it_is_absent_or_whole(
    kind: str, exchange: bool, tmp_path: Path, runner: Runner
) -> None:
    place = Place(kind, tmp_path, runner)
    seen = set()
    for at in range(1, 1000):
        run = place.strike(at, Fault(at, KILL, exchange=exchange))
        found = place.look(place.path)
        seen.add(found is not None)
        assert found in (None, at)
        if not run.struck:
            assert run.code == 0, run.words
            break
        if found is not None:
            place.write(at)
            remove(place)
    assert seen == {False, True}


def remove(place: Place) -> None:
    for path in place.folder.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def test_a_missing_folder_is_restored_by_a_command_that_reads_it(tmp_path: Path, runner: Runner) -> None:
    """The process is killed between the two renames of a system that cannot exchange folders."""
    room = tmp_path / "room"
    written.write_room(str(room), 1)
    for at in range(1, 1000):
        run = runner.run("tests.written:write_room", [str(room), 2], Fault(at, KILL, exchange=False))
        assert run.struck
        if not room.exists():
            break
    assert "correction/manifest.toml: missing" in fail("play", room, CLIP, "--output", tmp_path / "o.png")
    assert written.room_generation(str(room)) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["room"]


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Start another process that holds `held.png` in the test's folder and has begun to write it."""
    code = (
        "import sys, time; from pathlib import Path; from counterlight.writing.replacing import replacing_file\n"
        "with replacing_file(Path(sys.argv[1])) as path:\n"
        "    path.write_text('half')\n    print('begun', flush=True)\n    time.sleep(600)"
    )
    with running(sys.executable, "-c", code, tmp_path / "held.png", folder=ROOT) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        yield process


def test_a_living_writers_things_stay_and_a_dead_ones_go(tmp_path: Path, writer: subprocess.Popen[str]) -> None:
    stage = tmp_path / ".held.png.counterlight-partial"
    written.write_file(str(tmp_path / "other.txt"), 1)
    assert (stage / "new" / "held.png").read_text() == "half"
    with pytest.raises(InputError, match=rf"held\.png: process {writer.pid} is writing it; wait"):
        written.write_file(str(tmp_path / "held.png"), 1)
    writer.kill()
    writer.wait()
    assert stage.exists()
    written.write_file(str(tmp_path / "other.txt"), 2)
    assert [path.name for path in tmp_path.iterdir()] == ["other.txt"]


def test_a_lock_is_not_a_number_that_another_process_may_have(tmp_path: Path) -> None:
    """A dead writer's note names this process, which lives but does not write."""
    stage = tmp_path / ".notes.txt.counterlight-partial"
    (stage / "new").mkdir(parents=True)
    (stage / "pid").write_text(str(os.getpid()))
    written.write_file(str(tmp_path / "other.txt"), 1)
    assert [path.name for path in tmp_path.iterdir()] == ["other.txt"]


@pytest.mark.parametrize("strange", ["file", "link", "folder"])
def test_what_was_not_made_by_us_is_left_alone(strange: str, tmp_path: Path) -> None:
    stage, treasure = tmp_path / ".notes.txt.counterlight-partial", tmp_path / "treasure"
    treasure.mkdir()
    (treasure / "gold").write_text("mine")
    if strange == "file":
        stage.write_text("mine")
    elif strange == "link":
        stage.symlink_to(treasure)
    else:
        treasure.rename(stage)
    with pytest.raises(InputError, match=r"is in the way of writing notes\.txt; move it away"):
        written.write_file(str(tmp_path / "notes.txt"), 1)
    written.write_file(str(tmp_path / "other.txt"), 1)
    assert (stage / "gold" if strange == "folder" else stage if strange == "file" else treasure / "gold").read_text()


@pytest.mark.parametrize("trap", ["new is a link", "the stage is a link", "the journal is a pipe", "endless"])
def test_what_came_with_a_folder_moves_nothing_of_others_and_holds_nobody(trap: str, tmp_path: Path) -> None:
    """A foreign folder looks as if a killed command had begun to move frames into it."""
    others, folder, pattern = tmp_path / "others", tmp_path / "folder", "%d.png"
    others.mkdir()
    folder.mkdir()
    (others / "0.png").write_text("precious")
    stage = (others if trap == "the stage is a link" else folder) / f".{pattern}{SUFFIX}"
    for name in ("old_frames", "new"):
        (stage / name).mkdir(parents=True)
    (stage / "pid").write_text("1")
    (stage / "new" / "1.png").write_text("new")
    if trap == "new is a link":
        shutil.rmtree(stage / "new")
        (stage / "new").symlink_to(others)
    if trap == "the journal is a pipe":
        os.mkfifo(stage / "out")
    else:
        (stage / "in").touch()
    if trap == "endless":
        os.truncate(stage / "in", 1 << 40)
    if trap == "the stage is a link":
        (folder / stage.name).symlink_to(stage)
    before = sorted(path for path in tmp_path.rglob("*"))
    finish(folder / pattern)
    assert sorted(path for path in tmp_path.rglob("*")) == before


def test_a_second_build_is_refused_at_once_and_leaves_nothing(tmp_path: Path) -> None:
    room = tmp_path / "room"
    written.write_room(str(room), 1)
    written.write_room_maps(str(room), 1)
    with maps.replacing(calibration.read(room)) as stage:
        line = fail("build", room)
        assert f"{room}/correction: process {os.getpid()} is writing it; wait until it has ended" in line
        line = fail("simulate", SCENE, "-o", room, "--force")
        assert f"{room}: process {os.getpid()} is writing correction in it" in line
        assert stage.is_dir()
        (stage / "manifest.toml").write_text("mine")
    assert (room / "correction" / "manifest.toml").read_text() == "mine"
    assert sorted(path.name for path in room.glob("*")) == [
        "ambient.exr", "calibration.toml", "correction", "mask.png",
        "transport_blue.npz", "transport_green.npz", "transport_red.npz",
    ]  # fmt: skip
    assert list(room.glob(".*")) == []


@pytest.mark.parametrize("kind", ["room", "maps"])
def test_what_is_read_while_it_is_replaced_is_of_one_generation(kind: str, tmp_path: Path) -> None:
    """Another process writes one generation after another without a pause.

    A room is read in two steps, calibration then transport. In between, the room may be refused, but never mixed.
    """
    write, name = KINDS[kind]
    folder = str(tmp_path / name)
    written.write_room(folder, 1)
    if kind == "maps":
        written.write_room_maps(folder, 1)
    code = (
        "import itertools, sys; from tests import written\n"
        f"for generation in itertools.count(2): written.write_{write}(sys.argv[1], generation)"
    )
    found = [1]
    with running(sys.executable, "-c", code, folder, folder=ROOT) as process:
        while len(set(found)) < 20:
            assert process.poll() is None
            try:
                found.append(getattr(written, f"{kind}_generation")(folder))
            except InputError as error:
                if "was replaced" not in str(error):
                    raise
            assert found == sorted(found)
