"""Every method on every picture of a room."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.command import track
from counterlight.errors import InputError
from counterlight.tools.study.methods import OURS, PLAIN, UNCUT, Method, Prepared
from counterlight.tools.study.pictures import Picture
from counterlight.tools.study.results import Row, Skipped, label
from counterlight.tools.study.rooms import StudyRoom, Task

SHOWN_PICTURES = 2
THESIS_LABEL, OURS_LABEL = (label(method.family, method.knob, method.value) for method in (PLAIN, OURS))
NNLS_LABEL = "NNLS"
SHOWN = ("uncompensated", "direct", THESIS_LABEL, OURS_LABEL, NNLS_LABEL)


@dataclass
class RoomFigures:
    """What was found in a room.

    seen : by picture and method, radiance over white, (camera height, camera width, 3), for the first pictures and the
    methods of SHOWN; "desired" is among them.
    """

    name: str
    facts: dict[str, float | int | str]
    mask: NDArray[np.bool_]
    rows: list[Row] = field(default_factory=list)
    skipped: list[Skipped] = field(default_factory=list)
    seen: dict[str, dict[str, FloatArray]] = field(default_factory=dict)


def study_room(
    room: StudyRoom,
    pictures: Sequence[Picture],
    methods: Sequence[Method],
    knobs: Sequence[Method] = (),
    patience_s: float = 0.0,
) -> RoomFigures:
    """Run methods, then, where inverting the uncut transport took at most `patience_s`, knobs that do it again."""
    found = RoomFigures(room.name, _facts(room), room.calibration.mask)
    tasks = [Task(room, picture) for picture in pictures]
    for task in tasks[:SHOWN_PICTURES]:
        found.seen[task.name] = {"desired": task.desired / room.white}
    for method in track(methods, f"{room.name}: methods", len(methods)):
        _run(method, room, tasks, found)
    took = max((row.preparation_s for row in found.rows if row.family == UNCUT), default=0.0)
    if took > patience_s:
        reason = f"inverting the uncut transport takes {took:.0f} s, more than --patience {patience_s:g}"
        found.skipped += [Skipped(room.name, _label(method), reason) for method in knobs]
        return found
    for method in track(knobs, f"{room.name}: knobs", len(knobs)):
        _run(method, room, tasks, found)
    return found


def _run(method: Method, room: StudyRoom, tasks: Sequence[Task], found: RoomFigures) -> None:
    try:
        for row, seen in _rows(method, method.prepare(room), tasks):
            found.rows.append(row)
            if row.picture in found.seen and row.label in SHOWN:
                found.seen[row.picture][row.label] = seen / room.white
    except InputError as error:
        found.skipped.append(Skipped(room.name, _label(method), str(error)))


def _rows(method: Method, ready: Prepared, tasks: Sequence[Task]) -> Iterator[tuple[Row, FloatArray]]:
    """The time of a frame is the first picture's, and that of the CPU, too, unless solving is what it times."""
    cpu_s: float | None = None
    frame_s: float | None = None
    for index, task in enumerate(tasks):
        driven = ready.drive(task)
        judged = task.judge(driven.drive)
        if index == 0:
            frame_s = ready.frame_s()
        if index == 0 or frame_s is None:
            cpu_s = ready.cpu_s(task)
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
                cpu_s=cpu_s,
                gl_ms=None if frame_s is None else 1000 * frame_s,
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
