"""A study in jobs, each a room and the methods that share its maps; jobs run here or in other processes.

A process that does several jobs of a room opens it once. The result of a job does not depend on the process, except
for times.
"""

import io
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, redirect_stderr
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from pathlib import Path
from threading import Lock
from typing import TypeVar
from uuid import uuid4

from counterlight.calibration import TOML
from counterlight.command import track
from counterlight.errors import InputError
from counterlight.jobs.workers import Here, Workers
from counterlight.tools.study.frames import graphics
from counterlight.tools.study.measure import RoomFigures, Trial
from counterlight.tools.study.methods import Method, catalogue, uncut_knobs
from counterlight.tools.study.pictures import BUILT_IN, find_pictures
from counterlight.tools.study.questions.place import Place
from counterlight.tools.study.questions.room_answers import tried
from counterlight.tools.study.rooms import open_room
from counterlight.tools.study.table_6_1 import OurRow, measure_at_thesis_size, scenes_of_the_table

ASKED_PICTURES = 3  # number of the study's pictures for questions about the user's own room
T = TypeVar("T")
_opened: "dict[RoomSource, Trial]" = {}  # the room opened last
_alone = Lock()  # one job per process at a time: a room keeps the maps made last, and OpenGL belongs to one thread


@dataclass(frozen=True)
class RoomSource:
    """The room that a process opens, and the pictures shown there.

    place, size, colour : arguments of open_room.
    pictures : names, made absolute by pictures.anywhere.
    opengl : renderer that times frames.
    run : unique per run, so that a process never reuses a room that has changed meanwhile.
    """

    place: Path
    size: tuple[int, int]
    colour: str
    pictures: tuple[str, ...]
    opengl: str
    run: str = field(default_factory=lambda: uuid4().hex)


Job = tuple[RoomSource, Callable[[], RoomFigures]]


def study_rooms(sources: Sequence[RoomSource], patience_s: float, workers: Workers) -> list[RoomFigures]:
    """Run every method in every room, the questions about the user's own room, and the knobs.

    patience_s : knobs that invert the uncut transport once more are skipped in rooms where one inversion took longer.
    """
    jobs = [(source, partial(_ask, source)) for source in sources if source.place.is_dir()]
    found = _gathered([*_methods(sources, catalogue()), *jobs], workers, "methods")
    knobs = uncut_knobs()
    patient = [source for source in sources if not found[source].refuses(patience_s)]
    turned = _gathered(_methods(patient, knobs), workers, "knobs")
    for source, figures in found.items():
        if source in turned:
            figures.take(turned[source])
        else:
            figures.skip(knobs, figures.refuses(patience_s))
    return [found[source] for source in sources]


def thesis_rows(picture: str, workers: Workers) -> list[OurRow]:
    """Returns the scenes of Table 6.1, measured at the sizes of the thesis.

    picture : name of the picture.
    """
    jobs = [partial(measure_at_thesis_size, scene, picture) for scene in scenes_of_the_table()]
    return _in_order(jobs, workers, "Table 6.1")


def files_of(places: Sequence[Path], pictures: Sequence[str]) -> list[Path]:
    """Returns the files that every process must see: scenes, calibration.toml of calibrations, pictures."""
    rooms = [place / TOML if place.is_dir() else place for place in places]
    return rooms + [Path(name) for name in pictures if name not in BUILT_IN]


def _methods(sources: Sequence[RoomSource], methods: Sequence[Method]) -> list[Job]:
    groups = [tuple(group) for _, group in groupby(methods, lambda method: method.made)]
    return [(source, partial(_try, source, group)) for source in sources for group in groups]


def _gathered(jobs: Sequence[Job], workers: Workers, what: str) -> Mapping[RoomSource, RoomFigures]:
    """Run all jobs and join the figures of each room, in the order of the jobs."""
    rooms = dict.fromkeys(source.place.stem for source, _ in jobs)
    parts = _in_order([job for _, job in jobs], workers, f"{', '.join(rooms)}: {what}")
    found: dict[RoomSource, RoomFigures] = {}
    for (source, _), part in zip(jobs, parts, strict=True):
        if source in found:
            found[source].take(part)
        else:
            found[source] = part
    return found


def _in_order(jobs: Sequence[Callable[[], T]], workers: Workers, what: str) -> list[T]:
    done = workers.completed([job if isinstance(workers, Here) else partial(_quietly, job) for job in jobs])
    parts = dict(track(done, what, len(jobs)))
    return [parts[number] for number in range(len(jobs))]


def _quietly(job: Callable[[], T]) -> T:
    """Run a job without progress output, which the calling process prints."""
    with redirect_stderr(io.StringIO()):
        return job()


def _try(source: RoomSource, methods: Sequence[Method]) -> RoomFigures:
    with _alone:
        trial = _trial(source)
        with closing(trial.room):
            return trial.of(methods)


def _ask(source: RoomSource) -> RoomFigures:
    """Answer the questions about the user's own room."""
    with _alone:
        trial = _trial(source)
        room, found = trial.room, trial.of(())
        if room.given is not None:
            pictures = find_pictures(source.pictures[:ASKED_PICTURES])
            found.tried = tried(Place(room.calibration, room.given, pictures, source.colour))
        return found


def _trial(source: RoomSource) -> Trial:
    """Returns the opened room. Raises InputError if this process renders frames with another OpenGL than the study."""
    if source not in _opened:
        if graphics() != source.opengl:
            raise InputError(
                f"--cluster: a worker's OpenGL is {graphics()}, here it is {source.opengl}; times of frames would not "
                "compare; use machines of one kind"
            )
        _opened.clear()
        room = open_room(source.place, source.size, source.colour)
        _opened[source] = Trial(room, find_pictures(source.pictures))
    return _opened[source]
