"""The answers about a room on the study's page: verdict, plots, tables."""

from collections.abc import Sequence
from html import escape

from counterlight.tools.report.page import Figure, Section
from counterlight.tools.study.questions.answers import Question
from counterlight.tools.study.questions.asked import Asked
from counterlight.tools.study.tables import html_table, number

CAPTION = (
    "Each mark is a setting: decibels below the best picture, means of the pictures; lower left is better. 0.1 dB "
    "(dotted) cannot be seen, 1 dB can side by side."
)


def verdict(asked: Asked) -> Section:
    """Returns the verdict, one sentence per question."""
    lines = "".join(f"<li><b>{escape(each.title)}.</b> {escape(each.verdict)}</li>" for each in asked.questions)
    size = f"Film, acquisition and colours: {escape(asked.size)}. All else: the room at its own size."
    note = f"<p class='note'>{size} Computed, not shown.</p>"
    return Section(f"{asked.room}: the verdict", [], f"<p>{escape(asked.verdict)}</p><ul>{lines}</ul>{note}")


def plots(asked: Asked, file: str) -> Section:
    return Section(
        f"{asked.room}: what costs, and what gives", [Figure("Every question", CAPTION, file=file)], wide=True
    )


def tables(asked: Asked) -> Section:
    return Section(f"{asked.room}: answers", [], "".join(_table(question) for question in asked.questions))


def _table(question: Question) -> str:
    cost = (question.cost,) if question.cost else ()
    header = ("setting", *cost, "dB below the best", *question.header)
    body = [
        [answer.setting, *([number(answer.cost)] if cost else []), f"{answer.below:.2f}", *answer.more]
        for answer in question.answers
    ]
    command = f" <code>{escape(question.command)}</code>" if question.command else ""
    notes = f"<p class='note'>{escape(question.how)}{command}</p>"
    return f"<details><summary>{escape(question.title)}</summary>{html_table(header, body)}{notes}</details>"


def headed(asked: Sequence[Asked], files: dict[str, str]) -> list[Section]:
    """Returns verdicts first, then plots, then tables."""
    kinds = [[verdict(each) for each in asked], [plots(each, files[f"asked {each.room}"]) for each in asked]]
    return [section for kind in [*kinds, [tables(each) for each in asked]] for section in kind]
