"""How many steps does a film need, whose frames go on from the one before, beside stills that begin anew?"""

from collections.abc import Sequence
from dataclasses import replace

from counterlight.arrays import FloatArray
from counterlight.maps.room_maps import RoomMaps
from counterlight.pipeline.room import Room
from counterlight.tools.inverse.inverse import InverseOptions
from counterlight.tools.inverse.room import build_maps
from counterlight.tools.study.frames import player
from counterlight.tools.study.pictures import film_frames
from counterlight.tools.study.questions.answers import CLOSE_DB, Answer, Question, cheapest, decibels, sentence
from counterlight.tools.study.questions.place import Place

FRAMES = 6  # one after another; the first has none before it, and is not counted
STEPS = (1, 2, 4, 8, 16)
FILM, STILLS = "film", "stills"
STARTS = {  # what is shown, and where its steps begin -> --refine-from
    f"{FILM}, from T⁺": "previous",
    f"{STILLS}, from T⁺": "map",
    f"{FILM}, from direct mapping": "previous-direct",
    f"{STILLS}, from direct mapping": "direct",
}


def film(place: Place) -> Question:
    """Frames of the shipped clip by the player: drive and momentum carried from frame to frame, or each by itself."""
    frames = film_frames(FRAMES)
    shown, judged = replace(place, pictures=frames), replace(place, pictures=frames[1:])
    maps = build_maps(place.tier, InverseOptions()).maps
    answers = []
    for series, start in STARTS.items():
        for steps in STEPS:
            drives = _drives(shown, maps, start, steps)[1:]
            option = f"--refine {steps} --refine-from {start}"
            below = max(judged.below(drives), 0.0)
            answers.append(Answer(f"{series}, {steps} steps", float(steps), below, (option,), f"{steps}", series))
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
    """Of each picture in turn, (projector pixels, 3)."""
    with player("cpu", Room(place.calibration, maps, place.tier.white, start=start)) as renderer:
        return [renderer.show(desired, compensate=True, steps=steps) for desired in place.desired]


def _verdict(answers: Sequence[Answer]) -> str:
    parts = []
    for kind in (FILM, STILLS):
        of_kind = [answer for answer in answers if answer.series.startswith(kind)]
        found = cheapest(of_kind, CLOSE_DB)
        best = min(of_kind, key=lambda answer: answer.below)
        parts.append(
            f"{found.setting}, is {decibels(found.below)} below the best"
            if found is not None
            else f"{kind} stay {decibels(best.below)} below the best with {best.setting}"
        )
    return sentence("; ".join(parts))
