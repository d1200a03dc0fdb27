"""Reads the options of counterlight play (options.py) from the command line and the settings file.

The settings file is TOML with the options' names, and `[keys]` for key bindings. Given options override it.
"""

import argparse
import os
from argparse import SUPPRESS
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from counterlight.command import Arguments, Parser
from counterlight.errors import InputError, nearest, shown
from counterlight.files.reading import read_toml
from counterlight.files.tables import LONGEST_TEXT
from counterlight.media.medium import Border, Medium
from counterlight.pipeline.value_types import Choice, Flag, Kind, UnreadError
from counterlight.show.keys import KEYS, MEANINGS, check_bindings
from counterlight.show.options import GROUPS, OPTIONS, Option
from counterlight.show.playlist import expand
from counterlight.show.registry import CommandError

EXAMPLES = (
    "counterlight play room film.mp4 --fullscreen --loop",
    "counterlight play room film.mp4 --output for_projector.mp4",
)
KEYS_TABLE = "keys"


def read_options(argv: Sequence[str] | None, description: str) -> argparse.Namespace:
    """Read the options. The command line overrides the settings file, which overrides the defaults.

    Adds these attributes:
    given : names of the options, as in OPTIONS, that the command line sets to another value than the default or the
        settings file.
    keys : key bindings of the settings file.
    media : the media (media/medium.py), with the lists in `lists` expanded.
    border : the files that lists and remotes may name.
    lasting : whether the show must go on without a user.
    """
    parser = _parser(description)
    config = parser.parse_known_intermixed_args(argv)[0]
    keys: dict[str, str] = {}
    if not config.no_config:
        path = config.config or _default_path(os.environ, Path.home())
        if config.config is not None or path.exists():
            keys = _apply_settings(parser, path)
    options = parser.parse_intermixed_args(argv)
    values = {name: name.replace("-", "_") for name in OPTIONS}
    options.given = {name for name, at in values.items() if getattr(options, at) != parser.get_default(at)}
    options.keys, options.lists = keys, [Medium(name) for name in options.media]
    roots = [options.media_root] if isinstance(options.media_root, Path) else options.media_root or []
    if not options.supervised:  # under a supervisor, a folder may be mounted later
        _check_folders(roots)
    options.border = Border.around(options.lists, roots, live=options.allow_live)
    remotes = options.control, options.remote, options.osc
    options.lasting = options.loop or options.supervised or any(remote is not None for remote in remotes)
    options.media = expand(options.lists, options.border, patient=options.lasting)
    return options


def _check_folders(roots: Sequence[Path]) -> None:
    for root in roots:
        if not root.is_dir():
            raise InputError(f"--media-root {root}: no such folder; make it first, or check its name")


def _parser(description: str) -> argparse.ArgumentParser:
    common = [f"--{name}" for name, row in OPTIONS.items() if row.common]
    parser = Parser(
        "play", description=description, epilog=_keys(), examples=EXAMPLES, common=common, allow_abbrev=False
    )
    parser.add_argument("calibration", type=Path, nargs="?", help="calibration folder with a correction map")
    parser.add_argument(
        "media",
        nargs="*",
        help="videos, pictures (.exr: camera radiance), numbered pictures (name%%05d.png), folders, lists (.m3u, .txt)",
    )
    for title, rows in GROUPS.items():
        group = parser.add_argument_group(title)
        for name, row in rows.items():
            _add(group, name, row)
    return parser


def _add(group: Arguments, name: str, row: Option) -> None:
    """Add an option to its group of the help."""
    settings: dict[str, Any] = {"default": row.default, "help": row.text.replace("%", "%%") if row.help else SUPPRESS}
    if isinstance(row.kind, Flag):
        settings["action"] = argparse.BooleanOptionalAction if row.setting else "store_true"
    elif isinstance(row.kind, Choice):
        settings["choices"] = row.kind.words
    else:
        settings |= {"type": _reader(row.kind), "metavar": row.value}
        settings |= {"action": Several} if row.several else {}
        settings |= {} if row.bare is None else {"nargs": "?", "const": row.bare}
    group.add_argument(f"--{name}", **settings)


def _reader(kind: Kind) -> Callable[[str], Any]:
    def read(word: str) -> Any:
        try:
            return kind.read(word)
        except UnreadError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return read


def _keys() -> str:
    """Return a list of the keys and their meanings, one line per meaning."""
    keys: dict[str, list[str]] = {}
    for key, command in KEYS.items():
        keys.setdefault(MEANINGS[command], []).append(key)
    return "\n".join(["keys:", *(f"  {', '.join(names):<21} {meaning}" for meaning, names in keys.items())])


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


def _default_path(environment: Mapping[str, str], home: Path) -> Path:
    """Return the path of the settings file by the XDG Base Directory Specification."""
    return Path(environment.get("XDG_CONFIG_HOME") or home / ".config") / "counterlight" / "player.toml"


def _apply_settings(parser: argparse.ArgumentParser, path: Path) -> dict[str, str]:
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
    if action.nargs == 0:  # the option is a flag
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
