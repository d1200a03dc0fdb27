"""docs/player.md for tests: its tables of keys; and all commands and properties, with arguments for the commands."""

import re

from tests.programs import ROOT
from tests.stage import Stage

PAGE = (ROOT / "docs" / "player.md").read_text()
ARGUMENTS: dict[str, list[object]] = {
    "seek": [1],
    "loadfile": ["clip.mkv", "append"],
    "playlist-remove": [1],
    "playlist-move": [0, 1],
    "show-text": ["hello", 200],
    "place-move": [0.1, 0],
    "place-scale": [0.9],
    "place-grab": [0.5, 0.5],
    "place-drag": [0.5, 0.45],
    "set": ["view", "camera"],
    "cycle": ["pause"],
    "add": ["contrast", 2],
    "multiply": ["refine", 2],
}


def commands() -> list[str]:
    """Returns the names of all commands."""
    return [*Stage().commands.names()]


def properties() -> dict[str, str]:
    """Returns each property and the values that it takes."""
    known = Stage().commands
    return {name: known.takes(name) for name in known.properties()}


def table(heading: str, number: int = 0) -> list[list[str]]:
    """Rows of a table below a heading of the page, without code marks."""
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    blocks = re.findall(r"(?:^\|.*\n)+", section, re.MULTILINE)
    rows = [re.split(r"(?<!\\) ?\| ?", line.strip().strip("|").strip()) for line in blocks[number].splitlines()[2:]]
    return [[cell.strip().strip("`").replace("\\|", "|") for cell in row] for row in rows]
