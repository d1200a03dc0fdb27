"""Numbered names such as `name%05d.png`, in the syntax of C and FFmpeg, and the files that form a sequence."""

import re
from pathlib import Path

from counterlight.errors import InputError

_FIELD = re.compile(r"%%|%0?(\d{0,2})d")  # the number with its minimum width, or a percent sign


def is_numbered(path: Path) -> bool:
    return any(field[0] != "%%" for field in _FIELD.finditer(path.name))


def name_of(pattern: str, number: int) -> str:
    """Return the name of a frame, such as `name00012.png`."""
    return _FIELD.sub(lambda field: "%" if field[0] == "%%" else str(number).zfill(int(field[1] or 0)), pattern)


def number_of(pattern: str, name: str) -> int | None:
    """Return the number of a frame, None for a name that does not match, such as `007.png` for `%d.png`."""
    literals, widths = _FIELD.split(pattern)[::2], _FIELD.split(pattern)[1::2]
    fields = ["%" if width is None else "([0-9]+)" for width in widths]
    expression = "".join(re.escape(text) + field for text, field in zip(literals, [*fields, ""], strict=True))
    match = re.fullmatch(expression, name)
    if match is None or not match.groups():
        return None
    number = int(match[1])
    return number if name_of(pattern, number) == name else None


def natural(name: str) -> list[tuple[int, str]]:
    """Return a sort key that puts `capture_2` before `capture_10`."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name.lower()) if part]


def sequence_at(pattern: Path) -> list[str]:
    """Return the names of an existing sequence, numbered from 0. A new sequence replaces all of them.

    Raises InputError for other numbers, because the files may be unrelated.
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
