"""Checked access to the tables of TOML files. Every message names the file, the table and the key.

Types are exact (true is no number), numbers finite and in range, texts and lists bounded, paths below a folder.
"""

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError, nearest, shown
from counterlight.files.reading import is_below

Vector = NDArray[np.float64]
LONGEST_TEXT, MOST_TABLES, MOST_ROWS = 1000, 1000, 4096
COMPARED = 100  # most unknown keys that are compared with a missing key


class Table:
    """A TOML table with checked access, which remembers the keys that were read.

    where : beginning of every message.
    fix : advice at the end of every message.
    """

    def __init__(self, values: Mapping[str, Any], where: str, fix: str = "") -> None:
        self.values, self.where, self.fix = values, where, fix
        self._known: set[str] = set()

    def __contains__(self, key: str) -> bool:
        self._known.add(key)
        return key in self.values

    def table(self, key: str, *, optional: bool = False) -> "Table":
        value = self.raw(key, {} if optional else None)
        if not isinstance(value, dict):
            raise self.refusal(f": needs a table [{key}]")
        return Table(value, f"{self.where}: [{key}]", self.fix)

    def tables(self, key: str, most: int = MOST_TABLES) -> list["Table"]:
        value = self.raw(key, None)
        if not (isinstance(value, list) and 0 < len(value) <= most and all(isinstance(entry, dict) for entry in value)):
            raise self.refusal(f": needs one to {most} [[{key}]]")
        return [Table(entry, f"{self.where}: {key} {index}", self.fix) for index, entry in enumerate(value, 1)]

    def format(self, expected: int) -> None:
        """Raise InputError unless the key `format` is `expected`."""
        found = self.values.get("format")
        if type(found) is not int or found != expected:
            raise self.refusal(f": format {shown(found)}, this version reads {expected}")

    def text(self, key: str, default: str | None = None, longest: int = LONGEST_TEXT) -> str:
        value = self.raw(key, default)
        if not isinstance(value, str) or len(value) > longest:
            raise self.wrong(key, f"a text of at most {longest} characters")
        return value

    def path(self, key: str, folder: Path) -> Path:
        """Return a path in `folder` or below."""
        name = self.text(key)
        if not is_below(name):
            raise self.wrong(key, f"a path relative to {folder}, without '..'")
        return folder / name

    def choice(self, key: str, known: Sequence[str], default: str | None = None) -> str:
        value = self.text(key, default)
        if value not in known:
            raise self.wrong(key, f"one of {', '.join(known)}{nearest(value, known)}")
        return value

    def truth(self, key: str, default: bool) -> bool:
        value = self.raw(key, default)
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false")
        return value

    def number(self, key: str, default: float | None, low: float, high: float) -> float:
        return float(self.numbers(key, 1, None if default is None else (default,), low, high)[0])

    def integer(self, key: str, default: int | None, low: int, high: int) -> int:
        value = self.raw(key, default)
        if type(value) is not int or not low <= value <= high:
            raise self.wrong(key, f"a whole number from {low} to {high}")
        return value

    def size(self, key: str, most: int) -> tuple[int, int]:
        """Read [width, height] of at most `most` pixels. Returns (height, width)."""
        value = self.raw(key, None)
        if not (isinstance(value, list) and len(value) == 2 and all(type(n) is int and n > 0 for n in value)):
            raise self.wrong(key, "[width, height]")
        width, height = value
        if width * height > most:
            raise self.wrong(key, f"[width, height] of at most {most} pixels")
        return height, width

    def vector(self, key: str, default: tuple[float, ...] | None = None, low: float = -1e6) -> Vector:
        return self.numbers(key, 3, default, low, 1e6)

    def colour(self, key: str) -> Vector:
        return self.numbers(key, 3, None, 0.0, 1.0)

    def rows(self, key: str, count: int | None, width: int, low: float, high: float) -> Vector:
        """Read a list of lists as numbers, (count, width). If `count` is None, any number of rows ≥ 2 is valid."""
        value = self.raw(key, None)
        fits = isinstance(value, list) and (len(value) == count if count else 2 <= len(value) <= MOST_ROWS)
        if not fits:
            wanted = f"a list of 2 to {MOST_ROWS}" if count is None else f"a list of {count}"
            raise self.wrong(key, f"{wanted} lists of {width} numbers")
        return np.array([Table({key: row}, self.where, self.fix).numbers(key, width, None, low, high) for row in value])

    def numbers(self, key: str, count: int, default: tuple[float, ...] | None, low: float, high: float) -> Vector:
        value = self.raw(key, default)
        listed = [value] if count == 1 and not isinstance(value, list | tuple) else value
        numeric = isinstance(listed, list | tuple) and all(
            isinstance(v, int | float) and not isinstance(v, bool) and low <= v <= high for v in listed
        )
        if not numeric or len(listed) != count:
            wanted = "a number" if count == 1 else f"{count} numbers"
            raise self.wrong(key, f"{wanted} from {low:g} to {high:g}")
        return np.array(listed, np.float64)

    def refuse_unknown(self) -> None:
        """Raise InputError for keys that were never read."""
        for key in self.values:
            if key not in self._known:
                hint = nearest(key, self._known) or f"; known are {', '.join(sorted(self._known))}"
                raise InputError(f"{self.where}: unknown key {shown(key)}{hint}")

    def wrong(self, key: str, expected: str) -> InputError:
        """Return the error for an unexpected value."""
        return self.refusal(f", {key}: found {shown(self.values.get(key))}, expected {expected}")

    def refusal(self, complaint: str) -> InputError:
        return InputError(f"{self.where}{complaint}{'; ' if self.fix else ''}{self.fix}")

    def raw(self, key: str, default: Any) -> Any:
        """Return a value of any type, for the caller to check."""
        self._known.add(key)
        value = self.values.get(key, default)
        if value is None:
            raise self._missing(key)
        return value

    def _missing(self, key: str) -> InputError:
        others = [other for other in self.values if other not in self._known][:COMPARED]
        near = difflib.get_close_matches(key, others, 1, 0.6)
        return self.refusal(f": needs {key}{f'; is {near[0]!r} meant to be it?' if near else ''}")
