"""Checked access to the tables of a scene file: every complaint names the file, the table and the key."""

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from player.errors import InputError
from player.response import Response, parse_response

Vector = NDArray[np.float64]


class Table:
    """A TOML table with checked access, remembering which keys were asked for."""

    def __init__(self, values: Mapping[str, Any], where: str) -> None:
        self.values, self.where = values, where
        self._known: set[str] = set()

    def __contains__(self, key: str) -> bool:
        self._known.add(key)
        return key in self.values

    def table(self, key: str, *, optional: bool = False) -> "Table":
        value = self._get(key, {} if optional else None)
        if not isinstance(value, dict):
            raise InputError(f"{self.where}: needs a table [{key}]")
        return Table(value, f"{self.where}: [{key}]")

    def tables(self, key: str) -> list["Table"]:
        value = self._get(key, None)
        if not (isinstance(value, list) and value and all(isinstance(entry, dict) for entry in value)):
            raise InputError(f"{self.where}: needs at least one [[{key}]]")
        return [Table(entry, f"{self.where}: {key} {index}") for index, entry in enumerate(value, 1)]

    def text(self, key: str, default: str | None = None) -> str:
        value = self._get(key, default)
        if not isinstance(value, str):
            raise InputError(f"{self.where}, {key}: found {value!r}, expected a text")
        return value

    def choice(self, key: str, known: Sequence[str], default: str | None = None) -> str:
        value = self.text(key, default)
        if value not in known:
            near = difflib.get_close_matches(value, known, 1, 0.5)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise InputError(f"{self.where}, {key}: found {value!r}, expected one of {', '.join(known)}{hint}")
        return value

    def truth(self, key: str, default: bool) -> bool:
        value = self._get(key, default)
        if not isinstance(value, bool):
            raise InputError(f"{self.where}, {key}: found {value!r}, expected true or false")
        return value

    def number(self, key: str, default: float | None, low: float, high: float) -> float:
        return float(self.numbers(key, 1, None if default is None else (default,), low, high)[0])

    def integer(self, key: str, default: int | None, low: int, high: int) -> int:
        value = self._get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise InputError(f"{self.where}, {key}: found {value!r}, expected a whole number from {low} to {high}")
        return value

    def vector(self, key: str, default: tuple[float, ...] | None = None, low: float = -1e6) -> Vector:
        return self.numbers(key, 3, default, low, 1e6)

    def colour(self, key: str) -> Vector:
        return self.numbers(key, 3, None, 0.0, 1.0)

    def rows(self, key: str, count: int | None, width: int, low: float, high: float) -> Vector:
        """(count, width) numbers, a list of lists; count None for two or more."""
        value = self._get(key, None)
        fits = isinstance(value, list) and (len(value) == count if count else len(value) >= 2)
        if not fits:
            wanted = "a list of at least two" if count is None else f"a list of {count}"
            raise InputError(f"{self.where}, {key}: found {value!r}, expected {wanted} lists of {width} numbers")
        return np.array([Table({key: row}, self.where).numbers(key, width, None, low, high) for row in value])

    def numbers(self, key: str, count: int, default: tuple[float, ...] | None, low: float, high: float) -> Vector:
        value = self._get(key, default)
        listed = [value] if count == 1 and not isinstance(value, list | tuple) else value
        numeric = isinstance(listed, list | tuple) and all(
            isinstance(v, int | float) and not isinstance(v, bool) and low <= v <= high for v in listed
        )
        if not numeric or len(listed) != count:
            wanted = "a number" if count == 1 else f"{count} numbers"
            raise InputError(f"{self.where}, {key}: found {value!r}, expected {wanted} from {low:g} to {high:g}")
        return np.array(listed, np.float64)

    def response(self) -> Response:
        try:
            return parse_response(self._get("response", "linear"))
        except InputError as error:
            raise InputError(f"{self.where}: {error}") from None

    def refuse_unknown(self) -> None:
        """InputError for keys that nobody asked for."""
        for key in self.values:
            if key not in self._known:
                near = difflib.get_close_matches(key, self._known, 1, 0.4)
                hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(sorted(self._known))}"
                raise InputError(f"{self.where}: unknown key {key!r}; {hint}")

    def _get(self, key: str, default: Any) -> Any:
        self._known.add(key)
        value = self.values.get(key, default)
        if value is None:
            self._suggest(key)
        return value

    def _suggest(self, key: str) -> None:
        near = difflib.get_close_matches(key, [other for other in self.values if other not in self._known], 1, 0.6)
        hint = f"; is {near[0]!r} meant to be it?" if near else ""
        raise InputError(f"{self.where}: needs {key}{hint}")
