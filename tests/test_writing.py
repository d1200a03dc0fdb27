"""Written or not written: kills, refusals and full disks at every step, and several processes at once."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests import written
from tests.faults import KILL, REFUSE, Fault, Runner

KINDS: dict[str, tuple[str, str]] = {  # what is written, and the name that it gets
    "file": ("file", "notes.txt"),
    "room": ("room", "room"),
    "maps": ("room_maps", "room"),
    "sequence": ("sequence", "frame%03d.png"),
}
Look = Callable[[str], int | None]


@pytest.fixture(scope="module")
def runner() -> Iterator[Runner]:
    with Runner() as runner:
        yield runner


class Place:
    """Where one kind of output is written, in generations."""

    def __init__(self, kind: str, folder: Path, runner: Runner) -> None:
        write, name = KINDS[kind]
        self.path, self._runner = str(folder / name), runner
        self.function, self.look = f"tests.written:write_{write}", getattr(written, f"{kind}_generation")
        self.folder = folder
        if kind == "maps":
            written.write_room(self.path, 0)

    def write(self, generation: int, fault: Fault | None = None) -> None:
        run = self._runner.run(self.function, [self.path, generation], fault)
        assert run.code == 0, run.words

    def left_over(self) -> list[str]:
        return [str(path.relative_to(self.folder)) for path in self.folder.rglob(".*")]


@pytest.mark.parametrize("exchange", [True, False], ids=["exchange", "journal"])
@pytest.mark.parametrize("how", [KILL, REFUSE])
@pytest.mark.parametrize("kind", KINDS)
def test_struck_at_any_step_the_old_or_the_new_is_whole(
    kind: str, how: str, exchange: bool, tmp_path: Path, runner: Runner
) -> None:
    """Generation by generation, each written over the one before and struck at the next step."""
    place = Place(kind, tmp_path, runner)
    place.write(1)
    kept, seen = 1, set()
    for generation in range(2, 1000):
        run = runner.run(place.function, [place.path, generation], Fault(generation - 1, how, exchange=exchange))
        if not run.struck:
            break
        assert run.code in ((-9,) if how == KILL else (0, 2)), run.words
        assert len(run.words.splitlines()) <= 1
        assert kind != "sequence" or one_generation(tmp_path)
        found = place.look(place.path)
        assert found in (kept, generation), run
        seen.add(found == generation)
        kept = found
        place.write(generation)  # the next command
        kept = generation
        assert place.look(place.path) == generation
        assert place.left_over() == []
    else:
        pytest.fail("never ended")
    assert seen == {False, True}
    assert generation > 10


def one_generation(folder: Path) -> bool:
    """Before anybody completes anything: frames of one generation, all of them if number 0 is there."""
    frames = {int(path.stem[-3:]): path for path in folder.glob("frame*.png")}
    generations = {written.frame_generation(path, number) for number, path in frames.items()}
    if 0 in frames:
        (generation,) = generations
        assert sorted(frames) == list(range(written.frames_of(generation)))
    return len(generations) <= 1
