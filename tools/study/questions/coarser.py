"""Question: what would a camera or a projector with half or a quarter of the pixels per side give?"""

from itertools import product

from counterlight.command import track
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.study.questions.answers import CLOSE_DB, Answer, Question, decibels, sentence
from counterlight.tools.study.questions.place import Place, blocks_of, made_coarser

FACTORS = {1: "whole", 2: "half", 4: "a quarter"}
SMALLEST = 8  # pixels per side of the smallest device that is tried


def sizes(place: Place) -> Question:
    """Try each pair of sizes: its own T, solved for the picture at that size, shown in the room at full size."""
    pairs = list(product(FACTORS, FACTORS))
    tried = (_tried(place, *pair) for pair in track(pairs, "fewer pixels", len(pairs)))
    answers = [answer for answer in tried if answer is not None]
    return Question(
        "Pixels of camera and projector",
        "entries of T",
        answers,
        _verdict(answers),
        "A coarser camera's pixels are means of its own, a coarser projector's light all that they stand for; what is "
        "solved with them is shown in the room as it is, and judged by the whole camera. Entries without the exchange "
        "between far cells, which no pixel changes.",
        ("camera", "projector"),
    )


def _tried(place: Place, camera: int, projector: int) -> Answer | None:
    calibration = place.calibration
    devices = (calibration.camera, camera), (calibration.projector, projector)
    if any(min(device.shape) < SMALLEST * factor for device, factor in devices if factor > 1):
        return None
    small, T = made_coarser(calibration, place.transport, camera, projector)
    if not small.mask.any():
        return None
    tier = tier_of(small, T, place.colour)
    seen, shown = blocks_of(calibration, camera, projector)
    desired = [seen.mean(each) for each in place.desired]
    drives = [shown.spread(drive) for drive in place.drives(tier, desired=desired)]
    far = 0 if T.far is None else T.far.gather.indices.size + T.far.scatter.indices.size
    names = f"{small.camera.width}x{small.camera.height}", f"{small.projector.width}x{small.projector.height}"
    words = f"camera {FACTORS[camera]}, projector {FACTORS[projector]}"
    return Answer(
        words, T.near.indices.size + far, max(place.below(drives), 0.0), names, names[1], f"camera {names[0]}"
    )


def _verdict(answers: list[Answer]) -> str:
    by_words = {answer.setting: answer for answer in answers}
    camera, projector = by_words.get("camera half, projector whole"), by_words.get("camera whole, projector half")
    parts = [
        f"a {name} of half the pixels a side costs {decibels(found.below)}"
        for name, found in (("projector", projector), ("camera", camera))
        if found is not None
    ]
    if not parts:
        return "The room is too small to be asked for less."
    spare = camera is not None and camera.below < CLOSE_DB
    end = "; the camera has more pixels than the projector can use" if spare else ""
    return sentence("; ".join(parts) + end)
