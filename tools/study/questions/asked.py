"""All questions about one room, and the verdict that stands above them."""

from collections.abc import Sequence
from dataclasses import dataclass

from counterlight.tools.study.pictures import Picture
from counterlight.tools.study.questions import acquiring, coarser, colours, drifting, figures, moving
from counterlight.tools.study.questions.answers import Question, decibels
from counterlight.tools.study.questions.place import Place, place_of
from counterlight.tools.study.results import Row, means
from counterlight.tools.study.rooms import StudyRoom
from counterlight.tools.transport.transport import Transport

PLAIN, DIRECT = "uncompensated", "direct"


@dataclass(frozen=True)
class Asked:
    """A room's answers.

    verdict : what is said of all, a sentence.  size : of the room that was asked, in words.
    """

    room: str
    verdict: str
    questions: tuple[Question, ...]
    size: str


def ask(room: StudyRoom, transport: Transport, pictures: Sequence[Picture], rows: Sequence[Row], colour: str) -> Asked:
    """Ask everything.  transport : of white light.  rows : the figures of the methods in this room."""
    place = place_of(room.calibration, transport, pictures, colour)
    found = [
        figures.steps(rows),
        figures.maps(rows),
        moving.film(place),
        acquiring.pictures(place),
        coarser.sizes(place),
        drifting.drift(place),
        colours.colours(place),
    ]
    questions = tuple(question for question in found if question is not None)
    return Asked(room.name, _overall(place, rows), questions, place.size)


def _overall(place: Place, rows: Sequence[Row]) -> str:
    by_label = {mean.label: mean.below_optimum_db for mean in means(rows)}
    reached = ", ".join(
        f"{value:.1f} dB ({picture.name})" for value, picture in zip(place.reached, place.pictures, strict=True)
    )
    worse = [
        f"{words} is {decibels(by_label[name])} below that"
        for name, words in ((PLAIN, "an uncorrected picture"), (DIRECT, "direct mapping"))
        if name in by_label
    ]
    return f"The best that this room can show is {reached}{'; ' if worse else ''}{', '.join(worse)}."
