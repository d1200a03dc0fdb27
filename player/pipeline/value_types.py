"""The kinds of values of options, settings and properties, such as flags and numbers, read from text or JSON."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

MANY = 1e6  # a bound this large counts as no bound in help texts


class UnreadError(ValueError):
    """A value was refused. The message states what was expected and found; the caller prepends the parameter's name."""


class Kind(Protocol):
    """The values that a parameter takes; str() lists them."""

    def read(self, value: object) -> Any:
        """Return the value in the parameter's type; raises UnreadError with what was expected."""

    def next(self, value: Any, direction: int) -> Any:
        """Return the next value for the command `cycle`; direction is 1 (up) or -1 (down)."""

    def info(self) -> dict[str, Any]:
        """Return `type` and its details for JSON, so that a remote can offer a suitable control."""


@dataclass(frozen=True)
class Flag:
    """True or false; "yes" and "no" as text."""

    def __str__(self) -> str:
        return "yes, no"

    def read(self, value: object) -> bool:
        words = {"yes": True, "true": True, "on": True, "no": False, "false": False, "off": False}
        if isinstance(value, bool):
            return value
        if isinstance(value, str) and value.lower() in words:
            return words[value.lower()]
        raise UnreadError(f"expected yes or no, found {value!r}")

    def next(self, value: bool, direction: int) -> bool:
        return not value

    def info(self) -> dict[str, Any]:
        return {"type": "flag"}


@dataclass(frozen=True)
class Number:
    """A number between two bounds.

    whole : only whole numbers are allowed.
    words : words that are allowed besides numbers.
    noun : name of the quantity in error messages.
    """

    low: float
    high: float
    whole: bool = False
    words: tuple[str, ...] = ()
    noun: str = ""

    def __str__(self) -> str:
        return ", ".join((*self.words, self.bounds))

    @property
    def bounds(self) -> str:
        return f"from {self.low:g}" if self._endless else f"{self.low:g} to {self.high:g}"

    def read(self, value: object) -> Any:
        if isinstance(value, str) and value in self.words:
            return value
        try:
            if isinstance(value, bool) or not isinstance(value, str | int | float):
                raise ValueError
            number = float(value)
        except (ValueError, OverflowError):
            number = math.nan
        if not self.low <= number <= self.high or (self.whole and number != round(number)):
            words = "".join(f"{word} or " for word in self.words)
            noun = self.noun or ("a whole number" if self.whole else "a number")
            to = "" if self._endless else f" to {self.high:g}"
            raise UnreadError(f"expected {words}{noun} from {self.low:g}{to}, found {value!r}")
        return int(number) if self.whole else number

    def next(self, value: Any, direction: int) -> Any:
        return self.clamp((0 if isinstance(value, str) else value) + direction)

    def clamp(self, number: float) -> Any:
        bounded = min(max(number, self.low), self.high)
        return round(bounded) if self.whole else bounded

    def info(self) -> dict[str, Any]:
        """Return JSON values; `max` is null without an upper bound, and `choices` lists the allowed words."""
        return {
            "type": "integer" if self.whole else "number",
            "min": self.low,
            "max": None if self._endless else self.high,
            "choices": list(self.words),
        }

    @property
    def _endless(self) -> bool:
        return self.high >= MANY


@dataclass(frozen=True)
class Choice:
    """One of several words."""

    words: tuple[str, ...]

    def __str__(self) -> str:
        return ", ".join(self.words)

    def read(self, value: object) -> str:
        if isinstance(value, str) and value in self.words:
            return value
        raise UnreadError(f"expected {self}, found {value!r}")

    def next(self, value: str, direction: int) -> str:
        return self.words[(self.words.index(value) + direction) % len(self.words)]

    def info(self) -> dict[str, Any]:
        return {"type": "choice", "choices": list(self.words)}


@dataclass(frozen=True)
class Places:
    """Places (x, y), or a word. Text: "0.3" or "0.3,1", several separated by spaces. JSON: 0.3, [0.3, 1], or a list.

    A single number is x; y is then 0.

    word : the word that is allowed instead of places.
    high : largest absolute value of x and y.
    most : largest number of places.
    """

    word: str
    high: float
    most: int

    def __str__(self) -> str:
        return f"{self.word}, X, X,Y, several"

    def read(self, value: object) -> Any:
        if value == self.word:
            return value
        try:
            places = tuple(_place(each) for each in _listed(value))
            near = all(abs(number) <= self.high for place in places for number in place)  # False for NaN
            if not near or not 1 <= len(places) <= self.most:
                raise ValueError
        except (TypeError, ValueError, OverflowError):
            raise UnreadError(f"expected {self.word}, X or X,Y, several with spaces between, found {value!r}") from None
        return places

    def next(self, value: Any, direction: int) -> Any:
        raise UnreadError("has no next value")

    def info(self) -> dict[str, Any]:
        return {"type": "any"}


def _listed(value: object) -> list[object]:
    """Split a value into places; a single place becomes a list of one."""
    if isinstance(value, str):
        return list(value.split())
    if isinstance(value, list | tuple) and any(isinstance(each, list | tuple) for each in value):
        return list(value)
    return [value]


def _place(value: object) -> tuple[float, float]:
    """Return (x, y); raises ValueError or TypeError for anything else."""
    numbers: Any = value.split(",") if isinstance(value, str) else value if isinstance(value, list | tuple) else [value]
    if any(isinstance(number, bool) for number in numbers):
        raise ValueError
    if len(numbers) not in (1, 2):
        raise ValueError
    x, y = [*map(float, numbers), 0.0][:2]
    return x, y


@dataclass(frozen=True)
class Anything:
    """Any value; the parameter's own setter checks it.

    words : describes the values.
    parse : converts text of the command line.
    """

    words: str = ""
    parse: Callable[[Any], Any] = lambda value: value

    def __str__(self) -> str:
        return self.words

    def read(self, value: object) -> Any:
        return self.parse(value)

    def next(self, value: Any, direction: int) -> Any:
        raise UnreadError("has no next value")

    def info(self) -> dict[str, Any]:
        return {"type": "any"}


FLAG, ANYTHING = Flag(), Anything()
