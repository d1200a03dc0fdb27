"""The player for tests: the keys of docs/player.md; all commands and properties, with arguments for the commands."""

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


def keys(number: int = 0) -> list[str]:
    """Returns the keys of the page in the page's order: keys of the show (0), or keys during placement (1)."""
    section = PAGE.partition("\n## Keys\n")[2].partition("\n## ")[0]
    tables = re.findall(r"(?:^\|.*\n)+", section, re.MULTILINE)
    cells = (row.split("|")[1] for row in tables[number].splitlines()[2:])
    return [key for cell in cells for key in re.findall(r"`([^`]+)`", cell)]
