"""A question about a room, the settings tried, and a verdict of one sentence."""

from collections.abc import Sequence
from dataclasses import dataclass

CLOSE_DB, NEAR_DB = 0.1, 1.0  # decibels below the best: CLOSE_DB is not visible, NEAR_DB is visible only side by side


@dataclass(frozen=True)
class Answer:
    """One setting that was tried.

    cost : in the question's unit; None if the question has no cost.
    below : decibels below the best, mean over the pictures.
    more : further cells of the table.
    mark : short name for the plot.
    series : name of the plotted line that it belongs to.
    """

    setting: str
    cost: float | None
    below: float
    more: tuple[str, ...] = ()
    mark: str = ""
    series: str = ""


@dataclass(frozen=True)
class Question:
    """A question with its answers.

    cost : name of the answers' cost, with its unit.
    verdict : a sentence or two.
    how : how it was tried.
    header : names of the cells in `more`.
    command : how a user gets what the verdict names.
    """

    title: str
    cost: str
    answers: Sequence[Answer]
    verdict: str
    how: str
    header: tuple[str, ...] = ()
    command: str = ""


def cheapest(answers: Sequence[Answer], within: float) -> Answer | None:
    """Returns the answer of least cost within `within` decibels of the best, or None."""
    close = [answer for answer in answers if answer.cost is not None and answer.below <= within]
    return min(close, key=lambda answer: answer.cost or 0.0, default=None)


def sentence(words: str) -> str:
    """Returns the words with a capital and a full stop."""
    return f"{words[0].upper()}{words[1:]}."


def decibels(value: float) -> str:
    """Returns decibels with two decimals, or "less than 0.01 dB"."""
    return "less than 0.01 dB" if value < 0.01 else f"{value:.2f} dB"
