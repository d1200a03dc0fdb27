"""Figures in text: cells of Markdown tables, of tables in columns, and matches of patterns; and their comparison.

A reader takes a page, or a command's output, and returns its cells by name. Two cells differ if their words differ, or
if a number is further off than a tolerance: units of the last digit that the page states, or a share of the number.
Seconds and milliseconds in a cell are compared as times.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

Cells: TypeAlias = dict[str, str]
Reader: TypeAlias = Callable[[str], Cells]
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
UNITS, SHARE = 2.0, 0.05  # allowed differences: rounding, and the order of float32 sums
ROUNDING = 0.6  # units, for a number with an exponent, which states only its order of magnitude
MOST_LABELS = 4  # in units of the last digit, for a number with an exponent, which states only its order of magnitude
SLOWER = 2.0  # factor by which times may differ on machines of one kind
SPENT = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e[+-]?\d+)?(?= m?s\b)")


@dataclass(frozen=True)
class Difference:
    """A cell where page and command differ.

    found : None if the command prints no such cell.
    """

    name: str
    stated: str
    found: str | None
    time: bool

    def __str__(self) -> str:
        return f"{self.name}: the page says {self.stated}, found {'nothing' if self.found is None else self.found}"


def markdown(beginning: str) -> Reader:
    """Returns a reader of tables whose header begins with `beginning`.

    Cells are named by table, row and column: `2: wall | any, clusters`. A row's name joins its
    first cells, enough to make the rows distinct; an empty cell repeats the cell above.
    """

    def read(text: str) -> Cells:
        cells: Cells = {}
        for number, (head, _, *rows) in enumerate(_tables(text, beginning), 1):
            for label, row in zip(_labels(rows), rows, strict=True):
                for column, cell in zip(head, row, strict=False):
                    cells[_free(cells, f"{number}: {label}, {column}")] = cell
        return cells

    return read


def _labels(rows: Sequence[Sequence[str]]) -> list[str]:
    filled, above = [], [""] * MOST_LABELS
    for row in rows:
        above = [cell or before for cell, before in zip(row, above, strict=False)]
        filled.append(above)
    for count in range(1, MOST_LABELS + 1):
        labels = [" | ".join(each[:count]) for each in filled]
        if len(set(labels)) == len(labels):
            break
    return labels


def _free(cells: Cells, name: str) -> str:
    """Returns the name, numbered if a cell has that name already."""
    return name if name not in cells else next(n for k in range(2, 10_000) if (n := f"{name} ({k})") not in cells)


def _tables(text: str, beginning: str) -> Iterator[list[list[str]]]:
    for block in re.findall(r"(?:^\|.*\n?)+", text, re.MULTILINE):
        rows = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip())[1:-1]] for line in block.splitlines()]
        if " | ".join(rows[0]).startswith(beginning):
            yield rows


def columns(beginning: str, named: Mapping[str, tuple[str, int]]) -> Reader:
    """Returns a reader of tables in columns, with two blanks between names and one between numbers.

    beginning : beginning of the header's line.
    named : name of a row -> its first word, and its index among rows with that word, from 1.
    """

    def read(text: str) -> Cells:
        head: Sequence[str] = ()
        rows: dict[tuple[str, int], dict[str, str]] = {}
        for line in text.splitlines():
            cells = line.split()
            if line.startswith(beginning):
                head = re.split(r" {2,}", line.strip())
            elif len(cells) == len(head) > 0 and all(re.fullmatch(r"[-+\d.e]+", cell) for cell in cells[1:]):
                count = sum(word == cells[0] for word, _ in rows) + 1
                rows[cells[0], count] = dict(zip(head, cells, strict=True))
        return {
            f"{name}, {column}": rows[at][column] for name, at in named.items() if at in rows for column in rows[at]
        }

    return read


def pattern(**patterns: str) -> Reader:
    """Returns a reader of the groups of each pattern's first match, joined by blanks; nothing without a match."""

    def read(text: str) -> Cells:
        found = {name: re.search(each, text) for name, each in patterns.items()}
        return {name: " ".join(match.groups()) for name, match in found.items() if match is not None}

    return read


def renamed(reader: Reader, names: Mapping[str, str]) -> Reader:
    """Keep only cells of these names, renamed."""
    return lambda text: {new: cell for old, cell in reader(text).items() if (new := names.get(old)) is not None}


def labelled(reader: Reader, label: str) -> Reader:
    """Keep only cells whose names contain `label`: some rows of a page's table."""
    return lambda text: {name: cell for name, cell in reader(text).items() if label in name}


def without(reader: Reader, *columns: str) -> Reader:
    """Drop cells of these columns, which a page keeps from earlier and no command prints."""
    ends = tuple(f", {column}" for column in columns)
    return lambda text: {name: cell for name, cell in reader(text).items() if not name.endswith(ends)}


def differences(
    stated: Cells, found: Cells, times: Callable[[str], bool], units: float = UNITS, share: float = SHARE
) -> list[Difference]:
    """Returns the differences between page and command; an empty cell states nothing.

    times : whether a cell name is a time.
    """

    def compared(name: str, cell: str) -> Difference | None:
        again = found.get(name)
        return _time_differs(name, cell, again) if times(name) else _differs(name, cell, again, units, share)

    pairs = (compared(name, cell) for name, cell in stated.items() if cell)
    return [each for each in pairs if each is not None]


def _time_differs(name: str, stated: str, found: str | None) -> Difference | None:
    return None if found is not None and like(stated, found) else Difference(name, stated, found, time=True)


def _differs(name: str, stated: str, found: str | None, units: float, share: float) -> Difference | None:
    """Returns a differing figure, or a cell in which only a time differs."""
    if found is None or not agree(SPENT.sub("t", stated), SPENT.sub("t", found), units, share):
        return Difference(name, stated, found, time=False)
    spent = [" ".join(SPENT.findall(each)) for each in (stated, found)]
    return None if like(*spent) else Difference(name, stated, found, time=True)


def agree(stated: str, found: str, units: float = UNITS, share: float = SHARE) -> bool:
    """Returns whether two cells have the same words, and numbers that differ by rounding."""
    one, other = _plain(stated), _plain(found)
    numbers = [NUMBER.findall(each) for each in (one, other)]
    if NUMBER.sub("#", one) != NUMBER.sub("#", other):
        return False
    return all(
        abs(float(a) - float(b)) <= max((ROUNDING if "e" in a else units) * last_digit(a), share * abs(float(a)))
        for a, b in zip(*numbers, strict=True)
    )


def like(stated: str, found: str) -> bool:
    """Returns whether two times have the same order of magnitude, to the last stated digit."""
    numbers = [NUMBER.findall(each) for each in (stated, found)]
    return len(numbers[0]) == len(numbers[1]) and all(
        max(float(a), float(b)) <= SLOWER * max(min(float(a), float(b)), last_digit(a))
        for a, b in zip(*numbers, strict=True)
    )


def last_digit(number: str) -> float:
    """Returns the value of one unit in the last digit: 0.01 for 3.14, 10 for 2.1e2."""
    mantissa, _, exponent = number.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(10.0 ** (int(exponent or 0) - decimals))


def _plain(cell: str) -> str:
    """Strip marks of emphasis, code and thousands; a dash counts as an empty cell."""
    return " ".join(re.sub(r"[*`–]|(?<=\d),(?=\d{3}\b)", "", cell).split())
