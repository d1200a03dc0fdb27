"""The parser of a verb, without running the verb."""

from importlib import import_module

import pytest

from counterlight.command import Parser
from counterlight.tools.verbs import VERBS


class Parsed(Exception):  # noqa: N818 - what carries a parser out of its command
    pass


def parser_of(verb: str) -> Parser:
    """Return the parser as the verb makes it."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("parse_known_args", "parse_known_intermixed_args"):
            patch.setattr(Parser, name, lambda parser, *_: (_ for _ in ()).throw(Parsed(parser)))
        with pytest.raises(Parsed) as caught:
            import_module(f"counterlight.{VERBS[verb].module}").main.args[0]([])
    parser: Parser = caught.value.args[0]
    return parser
