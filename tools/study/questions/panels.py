"""The questions about a room as one plot, one panel per question."""

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from counterlight.tools.study.plots import cost_axis, decibel_axis, save
from counterlight.tools.study.questions.answers import CLOSE_DB, Answer, Question
from counterlight.tools.study.questions.asked import Asked
from counterlight.tools.study.results import UNSEEN_DB

COLUMNS = 3
MARKS = "os^Dvp*X"


def draw(path: Path, asked: Asked) -> str:
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
