"""Question: how many steps does a film need, whose frames start from the frame before, compared with stills?"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

from counterlight.arrays import FloatArray
from counterlight.maps.room_maps import RoomMaps
from counterlight.pipeline.room import Room
from counterlight.tools.inverse.build import build_maps
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.study.frames import player
from counterlight.tools.study.pictures import film_frames
from counterlight.tools.study.questions.answers import CLOSE_DB, Answer, Question, cheapest, decibels, sentence
from counterlight.tools.study.questions.place import Place

FRAMES = 6  # consecutive frames; the first has no frame before it, and is not counted
STEPS = (1, 2, 4, 8, 16)
CARRIED = {"T⁺": "previous", "direct mapping": "previous-direct"}  # start of refinement -> --refine-from
ALONE = {"T⁺": "map", "direct mapping": "direct"}
KINDS = {"film": CARRIED, "stills": ALONE}


def film(place: Place) -> Question:
    """Show frames of the shipped clip by the player: drive and momentum carried over, or each frame alone."""
    frames = film_frames(FRAMES)
    shown, judged = replace(place, pictures=frames), replace(place, pictures=frames[1:])
    maps = build_maps(place.tier, InverseOptions()).maps
    answers = []
    for (kind, starts), begin, steps in product(KINDS.items(), CARRIED, STEPS):
        below = judged.below(_drives(shown, maps, starts[begin], steps)[1:])
        option = f"--refine {steps} --refine-from {starts[begin]}"
        series = f"{kind}, from {begin}"
        answers.append(Answer(f"{series}, {steps}", float(steps), max(below, 0.0), (option,), f"{steps}", series))
    return Question(
        "Film and stills",
        "steps a frame",
        answers,
        _verdict(answers),
        f"{place.size}; {FRAMES} frames of the shipped clip, the mean of all but the first.",
        ("options",),
        command="counterlight play",
    )


def _drives(place: Place, maps: RoomMaps, start: str, steps: int) -> list[FloatArray]:
    """Returns the drive of each picture in turn, (projector pixels, 3)."""
    with player("cpu", Room(place.calibration, maps, place.tier.white, start=start)) as renderer:
        return [renderer.show(desired, compensate=True, steps=steps) for desired in place.desired]


def _verdict(answers: Sequence[Answer]) -> str:
    clauses = (f"from {begin}, {' and '.join(_needed(answers, kind, begin) for kind in KINDS)}" for begin in CARRIED)
    return sentence(f"within {CLOSE_DB:g} dB of the best {'; '.join(clauses)}")


def _needed(answers: Sequence[Answer], kind: str, begin: str) -> str:
    of_kind = [answer for answer in answers if answer.series == f"{kind}, from {begin}"]
    found = cheapest(of_kind, CLOSE_DB)
    if found is None:
        return f"{kind} never ({decibels(of_kind[-1].below)} after {of_kind[-1].mark} steps)"
    return f"{kind} after {found.mark} step{'' if found.mark == '1' else 's'} ({decibels(found.below)})"
