"""Pages of the site that are generated: options, the player's tables, keys of scenes, Python names, notebooks.

docs/hooks.py adds them to the site (`make docs`).
"""

import inspect
from argparse import SUPPRESS
from collections.abc import Iterable, Iterator, Sequence

import counterlight
from counterlight.command import Parser, _Formatter
from counterlight.show.keys import KEYS, MEANINGS, PLACING
from counterlight.tools.simulation import scene
from counterlight.tools.verbs import VERBS
from tests.notebook import markdown
from tests.parsers import parser_of
from tests.programs import ROOT
from tests.stage import Stage


def pages() -> dict[str, str | bytes]:
    """Returns the content of each page and picture by its path below docs/."""
    notebooks = (markdown(path) for path in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")))
    ran = {f"notebooks/{name}": content for files in notebooks for name, content in files}
    texts = {
        "reference/options.md": options(),
        "reference/player.md": player(),
        "reference/python.md": python(),
        "reference/scenes.md": scenes(),
    }
    return {**texts, **ran}


def options() -> str:
    """Returns a section per verb, with a table per group of options."""
    parts = ["# Options of all commands", "This page lists what `counterlight VERB --help-all` prints."]
    for verb in VERBS:
        parser = parser_of(verb)
        parts += [f"## {verb}", _code(parser.format_usage().removeprefix("usage: ")), *_groups(parser)]
    return "\n\n".join(parts) + "\n"


def _groups(parser: Parser) -> Iterator[str]:
    names = _Formatter(parser.prog)
    for group in parser._action_groups:
        rows = [
            (f"`{names._format_action_invocation(action)}`", names._expand_help(action))
            for action in group._group_actions
            if action.help != SUPPRESS and action.dest not in ("help", "help_all")
        ]
        if rows:
            yield f"**{(group.title or '').capitalize()}**"
            yield table(("option", "meaning"), rows)


def player() -> str:
    known = Stage().commands
    commands = [(f"`{name}`", _marked(known.usage(name)), text) for name, text in known.names().items()]
    properties = [(f"`{name}`", known.takes(name), text) for name, text in known.properties().items()]
    parts = ["# Keys, commands and properties of the player"]
    for title, bindings in (("Keys", KEYS), ("Keys during placement", PLACING)):
        rows = [(f"`{key}`", f"`{words}`", MEANINGS[words]) for key, words in bindings.items()]
        parts += [f"## {title}", table(("key", "command", "meaning"), rows)]
    parts += ["## Commands", table(("command", "arguments", "meaning"), commands)]
    parts += ["## Properties", table(("property", "values", "meaning"), properties)]
    return "\n\n".join(parts) + "\n"


def python() -> str:
    """Returns a directive of mkdocstrings for each public name."""
    names = sorted(set(counterlight.__all__) - {"__version__"})
    homes = {name: f"{getattr(counterlight, name).__module__}.{name}" for name in names}
    return "\n\n".join(["# Python: all names", *(f"::: {home}" for home in homes.values())]) + "\n"


def scenes() -> str:
    """Returns the keys of scene files, from the docstring of their parser."""
    return f"# Keys of scene files\n\n{inspect.cleandoc(scene.__doc__ or '')}\n"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in lines)


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _marked(words: str) -> str:
    return f"`{words}`" if words else ""


def _code(text: str) -> str:
    return f"```\n{text.strip()}\n```"
