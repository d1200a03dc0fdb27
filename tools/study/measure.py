"""Every method on every picture of a room."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.command import track
from counterlight.errors import InputError
from counterlight.tools.study.methods import DEFAULTS, OURS, PLAIN, UNCUT, Method, Prepared
from counterlight.tools.study.pictures import Picture
from counterlight.tools.study.questions.room_answers import Tried
from counterlight.tools.study.results import Row, Skipped, label
from counterlight.tools.study.rooms import StudyRoom, Task

SHOWN_PICTURES = 2
THESIS_LABEL, OURS_LABEL = (label(method.family, method.knob, method.value) for method in (PLAIN, OURS))
UNCUT_LABEL = label(UNCUT, "max-error", DEFAULTS.max_error)
NNLS_LABEL = "NNLS"
SHOWN = ("uncompensated", "direct", THESIS_LABEL, OURS_LABEL, NNLS_LABEL)


@dataclass
class RoomFigures:
    """The figures of a room.

    seen : radiance over white by picture and method, (camera height, camera width, 3), for the first pictures and the
        methods of SHOWN; "desired" is among them.
    tried : answers about the user's own room; None for other rooms.
    """

    name: str
    facts: dict[str, float | int | str]
    mask: NDArray[np.bool_]
    rows: list[Row] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    seen: dict[str, dict[str, FloatArray]] = field(default_factory=dict)
    tried: Tried | None = None

    def take(self, more: "RoomFigures") -> None:
        """Add the figures of other methods in this room."""
        self.rows += more.rows
        self.skipped += more.skipped
        self.tried = self.tried or more.tried
        for picture, by_method in more.seen.items():
            self.seen.setdefault(picture, {}).update(by_method)

    def refuses(self, patience_s: float) -> str:
        """Returns the reason to skip knobs that invert the uncut transport once more: an error, the time, or ""."""
        failed = next((entry.reason for entry in self.skipped if entry.method == UNCUT_LABEL), "")
        if failed:
            return failed
        took = max((row.preparation_s for row in self.rows if row.family == UNCUT), default=0.0)
        if took <= patience_s:
            return ""
        return f"inverting the uncut transport takes {took:.0f} s, more than --patience {patience_s:g}"

    def skip(self, methods: Iterable[Method], reason: str) -> None:
        self.skipped += [Skipped(self.name, _label(method), reason) for method in methods]


class Trial:
    """A room in which methods are tried on pictures. The best drive of each picture is kept."""

    def __init__(self, room: StudyRoom, pictures: Sequence[Picture]) -> None:
        self.room, self._tasks = room, [Task(room, picture) for picture in pictures]

    def of(self, methods: Iterable[Method]) -> RoomFigures:
        room = self.room
        found = RoomFigures(room.name, _facts(room), room.counts)
        for task in self._tasks[:SHOWN_PICTURES]:
            found.seen[task.name] = {"desired": task.desired / room.white}
        for method in methods:
            self._run(method, found)
        return found

    def _run(self, method: Method, found: RoomFigures) -> None:
        try:
            for row, seen in _rows(method, method.prepare(self.room), self._tasks):
                found.rows.append(row)
                if row.picture in found.seen and row.label in SHOWN:
                    found.seen[row.picture][row.label] = seen / self.room.white
        except InputError as error:
            found.skipped.append(Skipped(self.room.name, _label(method), str(error)))


def study_room(room: StudyRoom, pictures: Sequence[Picture], methods: Sequence[Method]) -> RoomFigures:
    """Try methods in a room."""
    return Trial(room, pictures).of(track(methods, f"{room.name}: methods", len(methods)))


def _rows(method: Method, ready: Prepared, tasks: Sequence[Task]) -> Iterator[tuple[Row, FloatArray]]:
    """Yield a row and the seen picture per task. Frame time is measured once, solver time per picture."""
    frame_s: float | None = None
    for index, task in enumerate(tasks):
        driven = ready.drive(task)
        judged = task.judge(driven.drive, any_exposure=driven.any_exposure)
        if index == 0:
            frame_s = ready.frame_s()
        yield (
            Row(
                room=task.room.name,
                picture=task.name,
                family=method.family,
                knob=method.knob,
                value=method.value,
                command=method.command,
                rmse=judged.quality.rmse,
                psnr_db=judged.quality.psnr,
                ssim=judged.quality.ssim,
                ciede2000=judged.quality.ciede2000,
                clipped=driven.clipped,
                below_optimum_db=judged.below_optimum,
                certified_db=judged.certified if np.isfinite(judged.certified) else None,
                bound_codes=None if ready.bound is None else 255 * ready.bound,
                preparation_s=ready.preparation_s,
                cpu_s=ready.cpu_s(task),
                frame_ms=None if frame_s is None else 1000 * frame_s,
                map_mib=None if ready.map_bytes is None else ready.map_bytes / 2**20,
            ),
            judged.seen,
        )


def _label(method: Method) -> str:
    return label(method.family, method.knob, method.value)


def _facts(room: StudyRoom) -> dict[str, float | int | str]:
    calibration, far = room.calibration, room.transport.far
    return {
        "camera": f"{calibration.camera.width}x{calibration.camera.height}",
        "projector": f"{calibration.projector.width}x{calibration.projector.height}",
        "simulation_s": room.simulation_s,
        "entries_a_camera_pixel": float(np.count_nonzero(room.transport.near.weights) / 3 / calibration.camera.pixels),
        "largest_cluster_projector_pixels": room.largest_cluster,
        "far_light": "yes" if far is not None else "no",
        "white": room.white,
    }
