"""Style and types: every command of `make lint`, run next to the other tests."""

import re
import subprocess
import sys

import pytest

from tests.programs import ROOT

RECIPE = re.compile(r"^lint:.*\n((?:\t.*\n)+)", re.MULTILINE)
PYTHON = "\t$(python) "


def commands() -> list[str]:
    """Return the arguments of Python in each line of the recipe of `make lint`."""
    found = RECIPE.search((ROOT / "Makefile").read_text())
    assert found
    lines = found[1].splitlines()
    assert all(line.startswith(PYTHON) for line in lines)
    return [line.removeprefix(PYTHON) for line in lines]


@pytest.mark.parametrize("arguments", commands())
def test_a_command_of_make_lint_finds_nothing(arguments: str) -> None:
    words = [sys.executable, *arguments.split()]
    done = subprocess.run(words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if done.returncode != 0:
        pytest.fail(f"{' '.join(words)}\n{done.stdout}", pytrace=False)
