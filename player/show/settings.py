"""The player's settings file: TOML with the options' names and `[keys]` for key bindings. Given options override it."""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from counterlight.errors import InputError, nearest, shown
from counterlight.files.reading import read_toml
from counterlight.files.tables import LONGEST_TEXT
from counterlight.show.keys import check_bindings
from counterlight.show.options import OPTIONS
from counterlight.show.registry import CommandError

KEYS_TABLE = "keys"


class Several(argparse.Action):
    """Collects the values of a repeated option. The first value replaces the default, which settings may set."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        before = getattr(namespace, self.dest)
        setattr(namespace, self.dest, [values] if before is self.default else [*before, values])


def default_path(environment: Mapping[str, str], home: Path) -> Path:
    """Return the path of the settings file by the XDG Base Directory Specification."""
    return Path(environment.get("XDG_CONFIG_HOME") or home / ".config") / "counterlight" / "player.toml"


def apply_settings(parser: argparse.ArgumentParser, path: Path) -> dict[str, str]:
    """Make a file's settings the defaults of a parser, and return its key bindings.

    Raises InputError for an unknown name, with the nearest known name, and for a value that its option refuses.
    """
    table = read_toml(path, "correct it, or start with --no-config")
    bindings = _bindings(table.pop(KEYS_TABLE, {}), path)
    options = {_name(action): action for action in parser._actions if action.option_strings}
    known = {name: options[name] for name, row in OPTIONS.items() if row.setting}
    for name, value in table.items():
        if name not in known:
            raise InputError(f"{path}: no setting {shown(name)}{nearest(name, [*known, KEYS_TABLE])}")
        action = known[name]
        parser.set_defaults(**{action.dest: _value(action, value, f"{path}: {name}")})
    return bindings


def _name(action: argparse.Action) -> str:
    return action.option_strings[0].removeprefix("--")


def _value(action: argparse.Action, value: Any, where: str) -> Any:
    """Convert a value as the command line would. A list stands for a repeated option."""
    if isinstance(action, Several) and isinstance(value, list):
        return [_single(action, item, where) for item in value]
    return _single(action, value, where)


def _single(action: argparse.Action, value: Any, where: str) -> Any:
    if action.nargs == 0:  # a flag
        if not isinstance(value, bool):
            raise InputError(f"{where}: expected true or false, found {shown(value)}")
        return value
    text = str(value)
    if isinstance(value, bool) or not isinstance(value, str | int | float) or not _is_one_line(text):
        raise InputError(f"{where}: expected text or a number, found {shown(value)}")
    try:
        read: Any = action.type(text) if callable(action.type) else text
    except argparse.ArgumentTypeError as error:
        raise InputError(f"{where}: {error}") from None
    if action.choices is not None and read not in action.choices:
        raise InputError(f"{where}: expected {', '.join(map(str, action.choices))}, found {shown(value)}")
    return read


def _is_one_line(text: str) -> bool:
    return len(text) <= LONGEST_TEXT and not any(ord(character) < 32 for character in text)


def _bindings(table: Any, path: Path) -> dict[str, str]:
    if not isinstance(table, dict):
        raise InputError(f"{path}: {KEYS_TABLE} is a table of keys and commands: [{KEYS_TABLE}]")
    try:
        return check_bindings(table)
    except CommandError as error:
        raise InputError(f"{path}: {error}") from None
