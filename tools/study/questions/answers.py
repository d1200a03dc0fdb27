"""A question about a room, what was tried, and in one sentence what came of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field

CLOSE_DB, NEAR_DB = 0.1, 1.0  # cannot be told apart; seen side by side


@dataclass(frozen=True)
class Answer:
    """One setting.

    cost : in the question's unit, None if it has none.  below : decibels below the best, mean of the pictures.
    more : further cells of the table.  mark : setting in a word or two, for the plot.  series : the line that it is of.
    """

    setting: str
    cost: float | None
    below: float
    more: tuple[str, ...] = ()
    mark: str = ""
    series: str = ""


@dataclass(frozen=True)
class Question:
    """cost : what answers cost, with its unit.  verdict : a sentence or two.  how : how it was tried.

    header : of `more`.  command : how a user gets what the verdict names.
    """

    title: str
    cost: str
    answers: Sequence[Answer]
    verdict: str
    how: str
    header: tuple[str, ...] = ()
    command: str = ""
    logarithmic: bool = field(default=True)


def cheapest(answers: Sequence[Answer], within: float) -> Answer | None:
    """The least cost that stays within so many decibels."""
    close = [answer for answer in answers if answer.cost is not None and answer.below <= within]
    return min(close, key=lambda answer: answer.cost or 0.0, default=None)


def sentence(words: str) -> str:
    """With a capital and a full stop."""
    return f"{words[0].upper()}{words[1:]}."


def decibels(value: float) -> str:
    """Two digits; what nobody sees is said so."""
    return "less than 0.01 dB" if value < 0.01 else f"{value:.2f} dB"
