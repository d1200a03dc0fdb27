"""Every command in the table of docs/accuracy.md gives the figure that the study states."""

import shlex
import shutil
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

from counterlight.files import exr
from counterlight.files.picture_files import encode_png
from counterlight.response import Response
from counterlight.tools.study.measure import study_room
from counterlight.tools.study.methods import catalogue, uncut_knobs
from counterlight.tools.study.pictures import find_pictures
from counterlight.tools.study.results import label
from counterlight.tools.study.rooms import Task, open_room
from tests.programs import here
from tests.rooms import write_blurred_room

PAGE = Path(__file__).parents[1] / "docs" / "accuracy.md"
CAMERA, PROJECTOR, CELLS = (36, 40), (32, 32), 6  # more projector pixels than the table's largest cluster
METHODS = {label(each.family, each.knob, each.value): each for each in (*catalogue(), *uncut_knobs())}
TOLERANCE_DB = 0.02  # the study renders with OpenGL, files with the processor: float32 sums in another order


def listed() -> list[str]:
    """Return the methods of the page's first table."""
    rows = PAGE.read_text(encoding="utf-8").split("\n| method |", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    return [row.split("|")[1].strip().removesuffix(" (solver)") for row in rows]


class Commanded:
    """A room with far light, a radiance picture in a file, and one copy of the room per kind of build."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._original = folder, folder / "room"
        write_blurred_room(self._original, np.random.default_rng(5), CAMERA, PROJECTOR, CELLS)
        self.studied = open_room(self._original, CAMERA)
        self.asked = find_pictures(["photograph"])[0]
        self._picture, self._plain = folder / "asked.exr", folder / "plain.png"
        self._task = Task(self.studied, self.asked)
        radiance = self.studied.tier.mixing.as_radiance(self._task.desired)
        exr.write_rgb(self._picture, np.asarray(radiance, np.float32))
        grid = np.linspace(0, 1, 1 << 12)
        codes = np.interp(self.asked.at(PROJECTOR), Response("srgb").to_linear(grid), grid)
        self._plain.write_bytes(encode_png(np.rint(65535 * codes).astype(np.uint16)))

    @cached_property
    def stated(self) -> dict[str, float]:
        """Return the study's result for every method of the page, dB below the optimum."""
        rows = study_room(self.studied, [self.asked], [METHODS[name] for name in listed()]).rows
        return {row.label: row.below_optimum_db for row in rows}

    def found(self, commands: str) -> float:
        """Return dB below the optimum of the drive that the last command writes."""
        room, output = self._original, self._folder / "drive.exr"
        for words in map(shlex.split, commands.split("; ")):
            _, verb, *options = words
            if verb == "build":
                room = self._built(options)
            elif verb == "play":  # without compensation, a picture fills the projector's raster
                picture = self._plain if "--no-compensation" in options else self._picture
                here(verb, room, picture, *options, "--output", output)
            else:
                here(verb, room, self._picture, *options, "-o", output)
        drive = np.asarray(exr.read_rgb(output), np.float64).reshape(-1, 3)
        exposed = "--no-compensation" in commands
        return self._task.judge(np.clip(drive, 0, 1), any_exposure=exposed).below_optimum

    def _built(self, options: list[str]) -> Path:
        room = self._folder / "_".join(["room", *options])
        if not room.exists():
            shutil.copytree(self._original, room)
            here("build", room, *options)
        return room


@pytest.fixture(scope="module")
def commanded(tmp_path_factory: pytest.TempPathFactory) -> Commanded:
    return Commanded(tmp_path_factory.mktemp("commands"))


def test_the_page_lists_methods_of_the_study() -> None:
    assert set(listed()) <= METHODS.keys()
    assert len(listed()) > 10


@pytest.mark.parametrize("name", listed())
def test_a_command_gives_the_studys_figure(commanded: Commanded, name: str) -> None:
    assert commanded.found(METHODS[name].command) == pytest.approx(commanded.stated[name], abs=TOLERANCE_DB)
