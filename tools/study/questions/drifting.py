"""Question: what does a shift of the picture after calibration cost, and what does tolerance of shifts cost?"""

import numpy as np
from scipy import ndimage

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration
from counterlight.command import track
from counterlight.tools.study.questions.answers import CLOSE_DB, Answer, Question, decibels
from counterlight.tools.study.questions.place import Place
from counterlight.tools.transport.objective import DEFAULT_AIMS, ObjectiveOptions

SHIFTS = (0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)  # in projector pixels
AIMS = (0.0, DEFAULT_AIMS.drift, 0.5)  # values of --drift


def drift(place: Place) -> Question:
    """Show the best drives for each --drift by a projector whose picture has moved right and down."""
    answers = []
    for aim in track(AIMS, "drift", len(AIMS)):
        drives = place.drives(place.tier, ObjectiveOptions(drift=aim))
        answers += [_shown(place, drives, shift, aim) for shift in SHIFTS]
    return Question(
        "Drift of the projector's picture",
        "projector pixels",
        answers,
        _verdict(answers),
        "The drive is moved by so many pixels on a diagonal, between pixels linearly, and shown by T.",
        command="counterlight verify ROOM --camera CAMERA finds drift and undoes it; counterlight build --drift PIXELS",
    )


def _shown(place: Place, drives: list[FloatArray], shift: float, aim: float) -> Answer:
    moved = [_moved(drive, place.calibration, shift) for drive in drives]
    series = f"--drift {aim:g}"
    return Answer(f"{shift:g} pixels, {series}", shift, max(place.below(moved), 0.0), (), "", series)


def _moved(drive: FloatArray, room: Calibration, shift: float) -> FloatArray:
    """Shift the picture of each projector separately."""
    step = shift / np.sqrt(2)
    picture = drive.reshape(*room.projector.shape, 3)
    moved = np.zeros_like(picture)
    for region in room.regions:
        moved[region.part] = ndimage.shift(picture[region.part], (step, step, 0), order=1, mode="nearest")
    return moved.reshape(-1, 3)


def _verdict(answers: list[Answer]) -> str:
    usual = [answer for answer in answers if answer.series == f"--drift {DEFAULT_AIMS.drift:g}"]
    at = {answer.cost: answer.below for answer in usual}
    seen = min((shift for shift in SHIFTS if at[shift] - at[0.0] > CLOSE_DB), default=None)
    end = "" if seen is None else f"; more than {CLOSE_DB:g} dB are lost from {seen:g} pixels on"
    return (
        f"A picture that has moved by half a projector pixel costs {decibels(at[0.5] - at[0.0])}, by one "
        f"{decibels(at[1.0] - at[0.0])}{end}. Being ready for a tenth costs "
        f"{decibels(at[0.0])} while nothing moves."
    )
