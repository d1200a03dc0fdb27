"""All questions about one room, and the verdict above them."""

from collections.abc import Sequence
from dataclasses import dataclass

from counterlight.tools.study.questions import acquiring, coarser, colours, drifting, figures, moving
from counterlight.tools.study.questions.answers import Question, decibels
from counterlight.tools.study.questions.place import Place, coarse
from counterlight.tools.study.results import Row, means

PLAIN, DIRECT = "uncompensated", "direct"


@dataclass(frozen=True)
class RoomAnswers:
    """A room's answers.

    verdict : one sentence on all.
    size : size of the room in which questions were tried, in words.
    """

    room: str
    verdict: str
    questions: tuple[Question, ...]
    size: str


@dataclass(frozen=True)
class Tried:
    """Questions that are answered by trying, without figures of methods.

    size : size of the room in which questions were tried, in words.
    """

    questions: tuple[Question, ...]
    size: str


def tried(own: Place) -> Tried:
    """Try all questions that need trying: at full size where pixel counts matter, otherwise in a coarse room."""
    place = coarse(own)
    found = [
        moving.film(place),
        acquiring.pictures(place),
        coarser.sizes(own),
        drifting.drift(own),
        colours.colours(place),
    ]
    return Tried(tuple(question for question in found if question is not None), place.size)


def answered(room: str, found: Tried, rows: Sequence[Row]) -> RoomAnswers:
    """Returns the answers to all questions.

    rows : the figures of the methods in this room.
    """
    questions = figures.steps(rows), figures.maps(rows), *found.questions
    return RoomAnswers(room, _overall(rows), questions, found.size)


def _overall(rows: Sequence[Row]) -> str:
    best = {row.picture: row.psnr_db + row.below_optimum_db for row in rows}
    by_label = {mean.label: mean.below_optimum_db for mean in means(rows)}
    reached = ", ".join(f"{value:.1f} dB ({name})" for name, value in best.items())
    worse = [
        f"{words} is {decibels(by_label[name])} below that"
        for name, words in ((PLAIN, "an uncorrected picture"), (DIRECT, "direct mapping"))
        if name in by_label
    ]
    return f"The best that this room can show is {reached}{'; ' if worse else ''}{', '.join(worse)}."
