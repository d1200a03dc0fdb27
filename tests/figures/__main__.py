"""python -m tests.figures [--all] [--only WORD]: run the commands that pages name, and list what is stale.

Without --all, only commands of less than MINUTES run. The exit code is 1 if a figure is stale or a command fails.
Changed times are only listed.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from tests.figures.cells import Difference, differences
from tests.figures.row import Figures
from tests.figures.rows import ROWS
from tests.figures.unchecked import SENTENCES, UNCHECKED
from tests.programs import ROOT

MINUTES = 5
# appears between tables on the first run
COMPILING = re.compile(r"^compiling for this processor, once.*\n", re.MULTILINE)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.figures", description=__doc__)
    parser.add_argument("--all", action="store_true", help=f"also run commands of {MINUTES} minutes or more (hours)")
    parser.add_argument("--only", default="", metavar="WORD", help="run only rows whose page or command has WORD")
    parser.add_argument("--list", action="store_true", help="print what would run, and exit")
    options = parser.parse_args()
    asked = [row for row in ROWS if options.only in row.name]
    rows = [row for row in asked if options.all or row.minutes < MINUTES]
    if options.list:
        print("\n".join([*map(_announced, rows), *_unchecked()]))
        return 0
    stale, failed = checked(rows)
    left = len({row.commands for row in asked} - {row.commands for row in rows})
    print(
        f"{stale} figures are stale"
        + (f", {failed} commands failed" if failed else "")
        + (f"; {left} commands take longer: make figures ALL=1" if left else "")
    )
    return int(stale + failed > 0)


def checked(rows: Sequence[Figures]) -> tuple[int, int]:
    """Returns the numbers of stale figures and of failed commands; prints each row."""
    stale, broken = 0, set[tuple[str, ...]]()
    for row in rows:
        print(_announced(row), flush=True)
        try:
            if row.commands in broken:
                raise CommandFailedError("its command failed above")
            stale += sum(not each.time for each in told(row))
        except CommandFailedError as error:
            print(f"  not checked: {error}", flush=True)
            broken.add(row.commands)
    return stale, len(broken)


def _announced(row: Figures) -> str:
    return f"{row.name} (about {row.minutes:g} minutes)"


def _unchecked() -> Iterator[str]:
    for page, beginning, why in UNCHECKED:
        yield f"not checked: {page}, table of {beginning.strip(' |')}: {why}"
    for page, words, why in SENTENCES:
        yield f"not checked: {page}, {words}: {why}"


class CommandFailedError(Exception):
    """A command ended with an error, so it is not known whether its figures are stale."""


def told(row: Figures) -> Iterator[Difference]:
    """Yield and print the differences."""
    start, page = time.monotonic(), (ROOT / row.page).read_text(encoding="utf-8")
    stated = row.stated(page)
    found = row.found(written_by(row.commands, row.files))
    different = differences(stated, found, row.times, row.units, row.share)
    for each in different:
        print(f"  {'another time' if each.time else 'stale'}: {each}", flush=True)
        yield each
    print(f"  {len(stated) - len(different)} of {len(stated)} figures are as stated, {time.monotonic() - start:.0f} s")


@cache
def written_by(commands: tuple[str, ...], files: tuple[str, ...]) -> str:
    """Returns what the commands print, run in sequence in a temporary folder, and the text of `files`.

    Raises CommandFailedError.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "calib_data").symlink_to(ROOT / "calib_data")
        printed = [_printed(shlex.split(command), folder) for command in commands]
        return "\n".join([*printed, *((folder / file).read_text(encoding="utf-8") for file in files)])


def _printed(words: list[str], folder: Path) -> str:
    program = [sys.executable, "-m", "counterlight"] if words[0] == "counterlight" else [sys.executable]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([*program, *words[1:]], cwd=folder, env=environment, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        raise CommandFailedError(f"{shlex.join(words)} ended with exit code {done.returncode}")
    return COMPILING.sub("", done.stdout)


if __name__ == "__main__":
    sys.exit(main())
