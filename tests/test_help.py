"""--help shows the common options on two screens, --help-all shows every option, and both fit the terminal."""

import re
import shlex
import shutil
from argparse import SUPPRESS, Action, BooleanOptionalAction
from pathlib import Path

import pytest

from counterlight.command import WIDEST
from counterlight.tools import verbs
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.verbs import VERBS
from tests.parsers import parser_of

TWO_SCREENS = 60  # lines of two screens
ROW = re.compile(r"^  (?:-\w, )?(--\S+)", re.MULTILINE)


def printed(verb: str, option: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as ended:
        verbs.main([verb, option])
    assert ended.value.code == 0
    return capsys.readouterr().out


def row_of(action: Action) -> str:
    """The option as the help lists it."""
    if isinstance(action, BooleanOptionalAction):
        return action.option_strings[0].replace("--", "--[no-]", 1)
    return action.option_strings[-1]


@pytest.mark.parametrize("columns", [60, 80, 100, 250])
@pytest.mark.parametrize("verb", VERBS)
def test_help_fits_and_help_all_is_complete(
    verb: str, columns: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    brief, whole = printed(verb, "--help", capsys), printed(verb, "--help-all", capsys)
    assert max(map(len, f"{brief}{whole}".splitlines())) <= min(columns, WIDEST)
    assert columns < 80 or len(brief.splitlines()) <= TWO_SCREENS
    parser = parser_of(verb)
    options = [action for action in parser._actions if action.option_strings]
    assert sorted(ROW.findall(whole)) == sorted(row_of(action) for action in options if action.help != SUPPRESS)
    common = [action for action in options if set(action.option_strings) & {*parser.common, "--help", "--help-all"}]
    required = [action for action in options if action.required]
    if parser.common:
        assert sorted(ROW.findall(brief)) == sorted({row_of(action) for action in (*common, *required)})
        assert set(parser.common) <= set(parser._option_string_actions)
    else:
        assert set(ROW.findall(whole)) - set(ROW.findall(brief)) == {"--help-all"}


@pytest.mark.parametrize("verb", VERBS)
def test_examples_are_accepted(
    verb: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The help of every verb shows two examples, and the verb accepts their options."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(next(iter(shipped_scenes().values())), "scene.toml")
    monkeypatch.setenv("COLUMNS", "80")
    parser, brief = parser_of(verb), printed(verb, "--help", capsys)
    assert len(parser.examples) == 2
    for example in parser.examples:
        assert f"\n  {example}\n" in brief
        program, named, *words = shlex.split(example.replace("\\\n", ""))
        assert (program, named) == ("counterlight", verb)
        parser.parse_args(words)


def test_every_option_and_argument_is_explained() -> None:
    unexplained = [(verb, action.dest) for verb in VERBS for action in parser_of(verb)._actions if not action.help]
    assert unexplained == []
