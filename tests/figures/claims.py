"""Figures in prose: sentences of a page, compared with a table of the page and with a command's output.

A sentence is written as on the page, with {} for each figure; line breaks do not matter. Its figures follow from cells
of a table: one cell, the least or the most of several, a difference. The sentence is therefore compared twice.
tests/test_figures.py compares it with the page's own table, to the last digit and without a command. make figures
compares it with what the table's command prints. Alternatively, the command prints the figures in a sentence of its
own, or next to the table.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

from tests.figures.cells import NUMBER, Cells, Reader, pattern
from tests.figures.row import Figures
from tests.figures.tables import TABLES

FIGURE = r"[-+]?\d+(?:[.,]\d+)*(?:e[-+]?\d+)?"
TIME = re.compile(r"\{\} (?:m?s|seconds|minutes)\b")


@dataclass(frozen=True)
class Table:
    """Cells of a table that are read as numbers."""

    cells: Cells

    def __call__(self, rows: str, column: str, at: int = 0) -> list[float]:
        """Returns the number at a place of each cell of a column, in rows whose names match a pattern (see cells.py).

        Raises LookupError if there is none.
        """
        found = [
            float(numbers[at])
            for name, cell in self.cells.items()
            if name.endswith(f", {column}") and re.search(rows, name.removesuffix(f", {column}"))
            if len(numbers := NUMBER.findall(cell.replace(",", ""))) > at
        ]
        if not found:
            raise LookupError(f"no number in rows of {rows}, column {column}")
        return found

    def one(self, rows: str, column: str, at: int = 0) -> float:
        """Returns the number of a single cell. Raises LookupError if several match."""
        [number, *others] = self(rows, column, at)
        if others:
            raise LookupError(f"several rows of {rows}, column {column}")
        return number


def ends(numbers: Sequence[float]) -> tuple[float, float]:
    """Returns the least and the most."""
    return min(numbers), max(numbers)


Formula: TypeAlias = Callable[[Table], Sequence[float]]


@dataclass(frozen=True)
class Prose(Figures):
    """Sentences of a page, with {} for each figure."""

    words: tuple[str, ...] = field(kw_only=True)

    @property
    def name(self) -> str:
        return f"{super().name}: prose, {self.words[0]}"


@dataclass(frozen=True)
class Said(Prose):
    """Sentences that follow from the cells of a table.

    of : the table's row.
    follow : reads the figures off the page that has the table.
    """

    of: Figures = field(kw_only=True)
    follow: Reader = field(kw_only=True)


def said(page: str, of: Figures, *claims: tuple[str, Formula]) -> Said:
    """Returns sentences of a page, with formulas for their figures from the table of another row."""

    def from_(read: Reader) -> Reader:
        return lambda text: _follow(Table(read(text)), claims)

    words = tuple(each for each, _ in claims)
    return Said(
        *(page, of.commands, of.minutes, sentences(*words), from_(of.found), of.files, is_time),
        words=words,
        of=of,
        follow=from_(of.stated),
    )


def counted(page: str, of: Figures, read: Reader, *claims: tuple[str, Formula]) -> Prose:
    """Returns sentences whose figures the table's commands also print, outside the tables of any page."""
    words = tuple(each for each, _ in claims)

    def found(text: str) -> Cells:
        return _follow(Table(read(text)), claims)

    return Prose(page, of.commands, of.minutes, sentences(*words), found, of.files, is_time, words=words)


def _follow(table: Table, claims: Sequence[tuple[str, Formula]]) -> Cells:
    cells: Cells = {}
    for words, formula in claims:
        try:
            cells[words] = " ".join(f"{number:.6g}" for number in formula(table))
        except LookupError:
            continue  # the table has no such cell
    return cells


def told(
    page: str, commands: tuple[str, ...], minutes: float, *claims: tuple[str, str], files: tuple[str, ...] = ()
) -> Prose:
    """Returns sentences of a page, and the sentences in which the commands print the same figures in the same order."""
    printed = {words: sentence(theirs) for words, theirs in claims}

    def found(text: str) -> Cells:
        return pattern(**printed)(_line(text))

    return Prose(page, commands, minutes, sentences(*printed), found, files, is_time, words=tuple(printed))


def sentences(*words: str) -> Reader:
    """Returns a reader of each sentence's figures, named by the sentence."""
    return lambda text: pattern(**{each: sentence(each) for each in words})(_line(text))


def sentence(words: str) -> str:
    """Returns a pattern for words with captured figures at {}, other figures at {_}, and anything at three dots."""
    marks = {"{}": f"({FIGURE})", "{_}": FIGURE, "...": ".*?"}
    return "".join(marks.get(part, re.escape(part)) for part in re.split(r"(\{_?\}|\.\.\.)", words))


def _line(text: str) -> str:
    return " ".join(text.split())


def is_time(words: str) -> bool:
    return bool(TIME.search(words))


def tabled(page: str, head: str, command: str = "") -> Figures:
    """Returns the row of a page's table whose header begins with `head`. Raises ValueError unless one matches."""
    [row] = [row for row in TABLES if (row.page, row.head) == (page, head) and command in row.name]
    return row
