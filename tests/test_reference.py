"""The generated pages of the site list every option, command, property and key."""

import re
from argparse import SUPPRESS

import pytest

from counterlight.files import tables
from counterlight.files.tables import Table
from counterlight.show.keys import KEYS, PLACING
from counterlight.tools.simulation import scene
from counterlight.tools.verbs import VERBS
from tests import reference
from tests.parsers import parser_of
from tests.player_page import commands, properties
from tests.programs import ROOT


def first_cells(text: str, heading: str) -> list[str]:
    """Returns the first cell of each row below a heading; each row has as many cells as its header."""
    section = text.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    cells = []
    for block in re.findall(r"(?:^\|.*\n?)+", section, re.MULTILINE):
        rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in block.splitlines()]
        assert {len(row) for row in rows} == {len(rows[0])}
        cells += [row[0].strip(" `") for row in rows[2:]]
    return cells


@pytest.mark.parametrize("verb", VERBS)
def test_each_verb_lists_its_options(verb: str) -> None:
    cells = first_cells(reference.options(), verb)
    listed = [names[0] for names in (re.findall(r"--(?:\[no-\]|no-)?([\w-]+)", cell) for cell in cells) if names]
    options = [action for action in parser_of(verb)._actions if action.option_strings and action.help != SUPPRESS]
    known = sorted(re.sub(r"^--(no-)?", "", action.option_strings[-1]) for action in options)
    assert sorted(["help", "help-all", *listed]) == known


def test_the_scenes_page_lists_each_key_that_the_parser_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    read = set[str]()

    class Recorded(Table):
        def refuse_unknown(self) -> None:
            read.update(self._known)
            super().refuse_unknown()

    for module in (scene, tables):
        monkeypatch.setattr(module, "Table", Recorded)
    for path in (ROOT / "calib_data" / "scenes").glob("*.toml"):
        scene.load_scene(path)
    assert {"samples", "black_level", "wander", "gloss", "dielectric", "roughness"} < read
    assert read <= set(re.findall(r"\w+", reference.scenes()))


@pytest.mark.parametrize(
    ("heading", "known"),
    [
        ("Keys", [*KEYS]),
        ("Keys during placement", [*PLACING]),
        ("Commands", commands()),
        ("Properties", [*properties()]),
    ],
)
def test_the_player_lists_all(heading: str, known: list[str]) -> None:
    assert first_cells(reference.player(), heading) == known
