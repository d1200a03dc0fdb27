"""Terminal output: lines, a status line that makes room for them, bars of constant length."""

import os
import pty
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from tests.programs import PATIENCE_S, ROOT, on, verb


def terminal(command: Sequence[object], columns: int = 80, **variables: str) -> bytes:
    """Return everything that a program writes to a terminal on stderr."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": str(columns), **variables}
    process = subprocess.Popen(list(map(str, command)), stderr=theirs, stdout=subprocess.DEVNULL, env=environment)
    os.close(theirs)
    seen = b""
    with suppress(OSError):  # the program has closed its side
        while part := os.read(ours, 4096):
            seen += part
    os.close(ours)
    assert process.wait(PATIENCE_S) == 0, seen
    return seen


def test_a_line_takes_the_place_of_the_status_and_the_status_fits_the_terminal() -> None:
    code = "from counterlight.command import status, tell; status('x' * 200); tell('a line'); status('end\\x1b[2J')"
    seen = terminal([sys.executable, "-c", code], columns=40)
    assert seen == b"\r\x1b[K" + b"x" * 39 + b"\r\x1b[Ka line\r\n\r\x1b[Kend\\x1b[2J"


def test_bars_keep_their_length_under_long_labels() -> None:
    code = "from counterlight.command import track; list(track(range(3), 'a label of many words ' * 9))"
    seen = terminal([sys.executable, "-c", code]).decode()
    assert "a label o…:   0 %|" + 20 * " " + "| 0 of 3" in seen


def test_a_player_says_where_it_is(xvfb: str, small_room: Path, folder: Path) -> None:
    command = *verb("play"), small_room, folder / "clip.mkv", "--no-config", "--no-audio"
    seen = terminal(command, **on(xvfb)).decode()
    lines = [line for line in seen.split("\r\x1b[K") if "fps" in line]
    assert any(line.startswith("0:00:0") and " %)" in line for line in lines), seen
    assert seen.endswith("\r\x1b[K")  # the last update clears the line
