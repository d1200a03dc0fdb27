"""Numbered names such as `name%05d.png`: which files of a folder are one sequence."""

import re
from pathlib import Path

from counterlight.errors import InputError

NUMBER = re.compile(r"%0?\d{0,2}d")


def is_numbered(path: Path) -> bool:
    return NUMBER.search(path.name) is not None


def name_of(pattern: str, number: int) -> str:
    """The name of a frame: `name00012.png`."""
    return NUMBER.sub(lambda match: match.group() % number, pattern)


def number_of(pattern: str, name: str) -> int | None:
    """The number of a frame; None for a name that is not of the pattern."""
    digits = r"(\d+)".join(re.escape(part) for part in NUMBER.split(pattern))
    match = re.fullmatch(digits, name)
    if match is None:
        return None
    number = int(match[1])
    return number if name_of(pattern, number) == name else None


def sequence_at(pattern: Path) -> list[str]:
    """The names of the sequence that is there, numbered from 0; InputError for other numbers, which may be no sequence.

    What is written under the pattern takes the place of all of them.
    """
    numbers = {number_of(pattern.name, path.name) for path in pattern.parent.iterdir()} - {None}
    names = [name_of(pattern.name, number) for number in range(len(numbers))]
    strange = numbers - set(range(len(numbers)))
    if strange:
        name = name_of(pattern.name, min(number for number in strange if number is not None))
        raise InputError(
            f"{pattern}: {name} is there and is of no sequence numbered from 0; move it away, or choose another name"
        )
    return names
