"""The answers about a room on the study's page (verdict, plots, tables), and as one plot with a panel per question."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from counterlight.tools.report.page import Figure, Section
from counterlight.tools.study.plots import cost_axis, decibel_axis, save
from counterlight.tools.study.questions.answers import CLOSE_DB, Answer, Question
from counterlight.tools.study.questions.room_answers import RoomAnswers
from counterlight.tools.study.results import UNSEEN_DB
from counterlight.tools.study.tables import html_table, number

CAPTION = (
    "Each mark is a setting: decibels below the best picture, means of the pictures; lower left is better. 0.1 dB "
    "(dotted) cannot be seen, 1 dB can side by side."
)
COLUMNS = 3
MARKS = "os^Dvp*X"


def verdict(asked: RoomAnswers) -> Section:
    """Returns the verdict, one sentence per question."""
    lines = "".join(f"<li><b>{escape(each.title)}.</b> {escape(each.verdict)}</li>" for each in asked.questions)
    size = f"Film, acquisition and colours: {escape(asked.size)}. All else: the room at its own size."
    note = f"<p class='note'>{size} Computed, not shown.</p>"
    return Section(f"{asked.room}: the verdict", [], f"<p>{escape(asked.verdict)}</p><ul>{lines}</ul>{note}")


def plots(asked: RoomAnswers, file: str) -> Section:
    return Section(
        f"{asked.room}: what costs, and what gives", [Figure("Every question", CAPTION, file=file)], wide=True
    )


def tables(asked: RoomAnswers) -> Section:
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


def headed(asked: Sequence[RoomAnswers], files: dict[str, str]) -> list[Section]:
    """Returns verdicts first, then plots, then tables."""
    kinds = [[verdict(each) for each in asked], [plots(each, files[f"asked {each.room}"]) for each in asked]]
    return [section for kind in [*kinds, [tables(each) for each in asked]] for section in kind]


def draw(path: Path, asked: RoomAnswers) -> str:
    """Write the picture; returns its name."""
    questions = [question for question in asked.questions if question.answers]
    lines = -(-len(questions) // COLUMNS)
    size = 4.4 * COLUMNS, 3.7 * lines
    figure, grid = plt.subplots(lines, COLUMNS, figsize=size, layout="constrained", squeeze=False)
    for axes, question in zip(grid.flat, questions, strict=False):
        _panel(axes, question)
    for axes in grid.flat[len(questions) :]:
        axes.set_visible(False)
    return save(path, figure)


def _panel(axes: Axes, question: Question) -> None:
    series = list(dict.fromkeys(answer.series for answer in question.answers))
    priced = any(answer.cost for answer in question.answers)
    for place, name in enumerate(series):
        members = [answer for answer in question.answers if answer.series == name]
        x = [_cost(answer, question, question.answers.index(answer)) for answer in members]
        y = [max(answer.below, UNSEEN_DB) for answer in members]
        axes.plot(x, y, marker=MARKS[place % len(MARKS)], linewidth=0.8 if name else 0, label=name, markersize=5)
        for answer, *at in zip(members, x, y, strict=True):
            axes.annotate(answer.mark, (at[0], at[1]), (4, 4), "data", "offset points", fontsize=7)
    axes.axhline(CLOSE_DB, color="#777777", linewidth=0.8, linestyle=":")
    if priced and 0 not in [answer.cost for answer in question.answers]:
        cost_axis(axes)
    if not priced:
        axes.set_xticks([])
    decibel_axis(axes)
    axes.set_xlabel(question.cost)
    axes.set_title(question.title, fontsize=10)
    if any(series):
        axes.legend(fontsize=7, frameon=False)


def _cost(answer: Answer, question: Question, place: int) -> float:
    return place if answer.cost is None else answer.cost
