"""The registry of all commands and properties, shared by keys, settings and the control socket.

Names are those of mpv, where mpv has the function. Values are JSON values. Words such as "yes" and "12.5" are also
accepted, because a key binding contains only words.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from counterlight.errors import InputError, nearest
from counterlight.pipeline.value_types import ANYTHING, Kind, Number, UnreadError
from counterlight.show.options import OPTIONS

PROPERTY_COMMANDS = ("set", "cycle", "add", "multiply")


class CommandError(ValueError):
    """A command or value was refused. The message is one line, for the screen or the socket."""


@dataclass(frozen=True)
class Property:
    """A value that can be read and, unless it is read-only, set.

    get : returns a JSON value.
    set : None if read-only.
    unit : shown after the value on the screen.
    costly : whether reading takes a part of a frame's time.
    """

    help: str
    get: Callable[[], Any]
    set: Callable[[Any], None] | None = None
    kind: Kind = ANYTHING
    unit: str = ""
    costly: bool = False


def named(name: str, get: Callable[[], Any], put: Callable[[Any], None]) -> Property:
    """Return the property for a row of OPTIONS."""
    row = OPTIONS[name]
    return Property(row.help, get, put, row.kind, row.unit)


@dataclass(frozen=True)
class Command:
    """A command.

    run : takes words or JSON values.
    usage : its arguments, with `[]` around optional arguments.
    """

    help: str
    run: Callable[..., object]
    usage: str = ""


class Commands:
    """Runs commands, and reads and sets properties by name. Raises CommandError for requests that cannot be met."""

    def __init__(self, commands: Mapping[str, Command], properties: Mapping[str, Property]) -> None:
        self._properties = dict(properties)
        self._commands = {
            **commands,
            "set": Command("set a property", self.set, "PROPERTY VALUE"),
            "cycle": Command("the next value of a property", self._cycle, "PROPERTY [up|down]"),
            "add": Command("add to a property; 1 by default", self._add, "PROPERTY [NUMBER]"),
            "multiply": Command("multiply a property", self._multiply, "PROPERTY FACTOR"),
        }

    def names(self) -> Mapping[str, str]:
        """Return every command with one line of help."""
        return {name: command.help for name, command in self._commands.items()}

    def usage(self, name: str) -> str:
        """Return a command's arguments in words."""
        usage: str = _named(self._commands, name, "command").usage
        return usage

    def properties(self) -> Mapping[str, str]:
        """Return every property with one line of help."""
        return {name: described.help for name, described in self._properties.items()}

    def takes(self, name: str) -> str:
        """Return the values that a property accepts, in words."""
        return str(_named(self._properties, name, "property").kind) if self.writable(name) else "read-only"

    def info(self, name: str) -> dict[str, Any]:
        """Return the description of a property for JSON."""
        row: Property = _named(self._properties, name, "property")
        facts = {
            "name": name,
            "help": row.help,
            "unit": row.unit,
            "costly": row.costly,
            "writable": row.set is not None,
        }
        return {**facts, **row.kind.info()}

    def writable(self, name: str) -> bool:
        return _named(self._properties, name, "property").set is not None

    def run(self, name: str, *arguments: object) -> object:
        """Run a command. Its result, if any, is a JSON value."""
        command = _named(self._commands, name, "command")
        _check_count(name, command, arguments)
        with _refusing(name):
            return command.run(*arguments)

    def check(self, name: str, *arguments: object) -> None:
        """Raise CommandError for a command that `run` would refuse in any state of the show. Runs nothing."""
        command = _named(self._commands, name, "command")
        _check_count(name, command, arguments)
        if name in PROPERTY_COMMANDS:
            described = _named(self._properties, arguments[0], "property")
            if described.set is None:
                raise CommandError(f"{arguments[0]} is read-only")
            if name == "set":
                with _refusing(str(arguments[0])):
                    described.kind.read(arguments[1])

    def get(self, name: str) -> Any:
        return _named(self._properties, name, "property").get()

    def set(self, name: str, value: object) -> None:
        described = _named(self._properties, name, "property")
        if described.set is None:
            raise CommandError(f"{name} is read-only")
        with _refusing(name):
            described.set(described.kind.read(value))

    def tell(self, name: str) -> str:
        """Return a property as shown on the screen: `Brightness: 5`."""
        described = self._properties[name]
        value = described.get()
        shown = {True: "on", False: "off", None: "no"}.get(value) if isinstance(value, bool | None) else None
        if shown is None:
            shown = f"{value:g}" if isinstance(value, float) else str(value)
        unit = f" {described.unit}" if described.unit and isinstance(value, int | float) else ""
        return f"{name.replace('-', ' ').capitalize()}: {shown}{unit}"

    def _cycle(self, name: str, direction: str = "up") -> None:
        kind = _named(self._properties, name, "property").kind
        steps = {"up": 1, "down": -1}
        if direction not in steps:
            raise UnreadError(f"expected up or down, found {direction!r}")
        self.set(name, kind.next(self.get(name), steps[direction]))

    def _add(self, name: str, amount: object = 1) -> None:
        kind, value = self._number(name)
        self.set(name, kind.clamp(value + Number(-math.inf, math.inf).read(amount)))

    def _multiply(self, name: str, factor: object) -> None:
        """Multiply a property. A whole number is rounded down; with a factor above 1 it grows by at least 1."""
        kind, value = self._number(name)
        by = Number(0, 1e6).read(factor)
        product = math.floor(value * by) if kind.whole else value * by
        self.set(name, kind.clamp(max(product, value + 1) if kind.whole and by > 1 else product))

    def _number(self, name: str) -> tuple[Number, Any]:
        described = _named(self._properties, name, "property")
        value = described.get()
        if not isinstance(described.kind, Number) or isinstance(value, str | None):
            raise CommandError(f"{name} is no number now, but {value!r}")
        return described.kind, value


def _named(table: Mapping[str, Any], name: object, what: str) -> Any:
    if isinstance(name, str) and name in table:
        return table[name]
    hint = nearest(name, table) if isinstance(name, str) else ""
    raise CommandError(f"no {what} {name!r}{hint}")


@contextmanager
def _refusing(name: str) -> Iterator[None]:
    """Convert errors about values into CommandError."""
    try:
        yield
    except UnreadError as error:
        raise CommandError(f"{name}: {error}") from None
    except InputError as error:
        raise CommandError(str(error)) from None


def _check_count(name: str, command: Command, arguments: Sequence[object]) -> None:
    least, most = _counts(command.usage)
    if not least <= len(arguments) <= most:
        raise CommandError(f"{name}: expected {command.usage or 'no arguments'}, found {_words(arguments)}")


def _counts(usage: str) -> tuple[int, int]:
    """Return the least and the largest number of arguments: `NAME [up|down]` -> (1, 2)."""
    arguments = usage.split()
    return sum(not argument.startswith("[") for argument in arguments), len(arguments)


def _words(arguments: Sequence[object]) -> str:
    return " ".join(map(str, arguments)) or "none"
