"""Runs counterlight verify as a child process during a show (docs/drift.md), without waiting for it."""

import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import IO, NamedTuple

from counterlight.command import NEXT

LONGEST_S = 600.0  # longest check, for a camera that does not answer
ENDING_S = 2.0  # seconds, less than the 3 s of silence after which a supervisor takes a player for dead


class Outcome(NamedTuple):
    """The result of a check.

    code : exit code.
    said : result in the last line of the output, without the next command.
    """

    code: int
    said: str


def last_line(output: bytes) -> str:
    """Return the last line of a process's output that is not blank."""
    lines = output.decode(errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")


class RoomChecks:
    """Runs checks of the room, one at a time.

    command : command line of a check.
    every_s : seconds from the end of a check, or from now, until the next check is due.
    clock : seconds, monotonic.
    """

    def __init__(self, command: Sequence[str], every_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._command, self._every_s, self._clock = list(command), every_s, clock
        self._since = clock()
        self._child: tuple[subprocess.Popen[bytes], IO[bytes]] | None = None

    @property
    def running(self) -> bool:
        return self._child is not None

    @property
    def due(self) -> bool:
        return not self.running and self._clock() - self._since >= self._every_s

    def begin(self) -> None:
        """Start a check. Raises OSError if no process can be started."""
        self._since = self._clock()
        said = tempfile.TemporaryFile()  # noqa: SIM115 - held until the child ends; a pipe could fill
        try:
            process = subprocess.Popen(self._command, stdin=subprocess.DEVNULL, stdout=said, stderr=said)
        except BaseException:
            said.close()
            raise
        self._child = process, said

    def outcome(self) -> Outcome | None:
        """Return the result of the running check, None until it has ended."""
        if self._child is None:
            return None
        process, said = self._child
        overdue = self._clock() - self._since > LONGEST_S
        if process.poll() is None and not overdue:
            return None
        said.seek(0)
        last = last_line(said.read()).partition(NEXT)[0]
        self.close()
        self._since = self._clock()
        return Outcome(process.returncode, f"it did not end in {LONGEST_S:.0f} s" if overdue else last)

    def close(self) -> None:
        """End the running check, if any."""
        if self._child is None:
            return
        process, said = self._child
        self._child = None
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(ENDING_S)
        process.kill()
        process.wait()
        said.close()
