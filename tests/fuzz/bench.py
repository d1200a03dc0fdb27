"""Commands that write, with injected faults: each output must be the whole old one or the whole new one.

A rerun of the command must succeed, and leave nothing else.
"""

import re
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from tests.faults import Fault, Run, Runner
from tests.fuzz.tally import CRASHED, HUNG, LEFT, READ, REFUSED, WRONG, Trial
from tests.writing_commands import COMMANDS, contents, furnish, is_whole, room_for, words_of, write_inputs

MARK = ".counterlight-partial"  # part of the name of every writer's hidden folder
SEQUENCE, CAPTURES = "f%02d.png", "made.captures"
REPORT = "made.report/"  # the files of a report contain measured seconds, so they differ between runs
KILLED, ASKED = -9, 130  # exit codes after kill -9, and after a request to end
NO_END = -1000  # replaces an exit code: the process had to be killed
Unit: TypeAlias = Mapping[str, bytes | None]


@dataclass(frozen=True)
class Blow:
    """How a command is struck.

    words : text of a finding.
    act : runs the command in a folder, and causes the fault.
    ends : exit codes that are allowed after the fault.
    exchange : whether folders can be exchanged.
    place : where the folder is filled and the command runs.
    resumed : whether the same command runs again afterwards, and must succeed.
    """

    words: str
    act: Callable[[Path], Run]
    ends: Sequence[int]
    exchange: bool = True
    place: Callable[[Path], AbstractContextManager[object]] = nullcontext
    resumed: bool = True


@dataclass(frozen=True)
class Clean:
    """An undisturbed run of a command: its steps, seconds and outputs.

    taken : bytes of the new files' pages.
    vague : outputs that differ from run to run.
    """

    steps: int
    seconds: float
    taken: int
    made: Mapping[str, Unit]
    vague: frozenset[str]


def units_of(folder: Path, vague: frozenset[str]) -> dict[str, Unit]:
    """Return a folder's content by units that are replaced as a whole: a file, a folder, a correction map, a sequence.

    Outputs named in `vague` are compared by their names only.
    """
    units: dict[str, dict[str, bytes | None]] = {}
    for name, content in contents(folder).items():
        if MARK not in name:
            units.setdefault(_unit(name), {})[name] = None if name in vague else content
    return units


def _unit(name: str) -> str:
    top, _, rest = name.partition("/")
    if top == "room" and rest.startswith("correction/"):
        return "room/correction"
    return SEQUENCE if re.fullmatch(r"f\d\d\.png", top) else top


class Bench:
    """Inputs of every command, and the command's outputs in an undisturbed run.

    out : the folder that commands write into, the same for every run.
    furnished : bytes of the pages of existing files.
    """

    def __init__(self, runner: Runner, scratch: Path, commands: Sequence[str] = tuple(COMMANDS)) -> None:
        self._runner, self._room, self.out = runner, scratch / "inputs" / "room", scratch / "out"
        write_inputs(self._room)
        self.furnished = room_for(furnish(self._emptied(), self._room))
        self.clean = {name: self._undisturbed(name) for name in commands}

    def trial(self, command: str, blow: Blow) -> Trial:
        clean, out = self.clean[command], self._emptied()
        with blow.place(out):
            furnish(out, self._room)
            before = units_of(out, clean.vague)
            begun = time.monotonic()
            struck = blow.act(out)
            seconds = time.monotonic() - begun
            found = _struck(struck, blow, out, before, clean)
        if found is None and blow.resumed:
            found = self._resumed(command, out, clean)
        verdict, words = found or (REFUSED if struck.code == 2 else READ, "")
        return Trial(verdict, f"{command}, {blow.words}: {words}", seconds, prompt=False)

    def run(self, command: str, out: Path, fault: Fault | None = None, more: Sequence[str] = ()) -> Run:
        function, (words,) = words_of(COMMANDS[command], out, self._room)
        return self._runner.run(function, [[*words, *more]], fault)

    def program(self, command: str, out: Path) -> list[str]:
        """Return the command as a separate process."""
        function, (words,) = words_of(COMMANDS[command], out, self._room)
        return [sys.executable, "-m", function.partition(":")[0], *words]

    def _undisturbed(self, command: str) -> Clean:
        """Run the command twice at the same path, because outputs contain paths."""
        runs, files = [], []
        for _ in range(2):
            out = self._emptied()
            before = furnish(out, self._room)
            begun = time.monotonic()
            runs.append(self.run(command, out))
            seconds = time.monotonic() - begun
            files.append(contents(out))
            assert runs[-1].code == 0, runs[-1].words
        differs = {key for key in files[0].keys() | files[1].keys() if files[0].get(key) != files[1].get(key)}
        vague = frozenset(differs | {key for key in files[0] if key.startswith(REPORT)})
        taken = room_for({key: content for key, content in files[1].items() if before.get(key) != content})
        return Clean(runs[0].steps, seconds, taken, units_of(out, vague), vague)

    def _resumed(self, command: str, out: Path, clean: Clean) -> tuple[str, str] | None:
        """Run the same command again, as a user would after a power failure."""
        again = ["--force"] if (out / "made").exists() else []  # the first run had finished, so that the output exists
        run = self.run(command, out, more=again)
        if run.code != 0:
            return CRASHED, f"the next run ended with {run.code}: {run.words}"
        if left := _left(out):
            return LEFT, f"after the next run: {left}"
        after = units_of(out, clean.vague)
        wrong = [unit for unit, files in clean.made.items() if unit != CAPTURES and after.get(unit) != files]
        return (WRONG, f"the next run leaves another {wrong}") if wrong else None

    def _emptied(self) -> Path:
        shutil.rmtree(self.out, ignore_errors=True)
        self.out.mkdir()
        return self.out


def _struck(run: Run, blow: Blow, out: Path, before: Mapping[str, Unit], clean: Clean) -> tuple[str, str] | None:
    """Return the finding right after the injected fault (a mutant, a signal, a full disk), or None."""
    if run.code == NO_END:
        return HUNG, run.words
    if run.code not in blow.ends or "Traceback" in run.words:
        return CRASHED, f"ended with {run.code}: {run.words}"
    if run.code == 2 and len([line for line in run.words.splitlines() if line.startswith("error")]) != 1:
        return CRASHED, f"no single line: {run.words}"
    after = units_of(out, clean.vague)
    for unit in before.keys() | clean.made.keys() | after.keys():
        complaint = _complaint(unit, after.get(unit), before.get(unit), clean.made.get(unit), out)
        if complaint and not (run.code == KILLED and _may_be_absent(unit, after, blow)):
            return WRONG, f"{unit}: {complaint}"
    left = _left(out)
    return (LEFT, f"by a command that ended with {run.code}: {left}") if left and run.code not in (KILLED, 0) else None


def _left(out: Path) -> list[str]:
    return [path.name for path in out.rglob("*") if MARK in path.name]


def _complaint(unit: str, after: Unit | None, before: Unit | None, made: Unit | None, out: Path) -> str:
    if after in (before, made):
        return ""
    if unit == CAPTURES and after is not None:
        broken = [name for name in after if not is_whole(out, name)]
        return f"{broken} are not whole" if broken else ""
    return "gone" if after is None else "neither what it was nor what it becomes"


def _may_be_absent(unit: str, after: Mapping[str, Unit], blow: Blow) -> bool:
    """Return whether a unit may be missing until the next command.

    A folder may be missing between two renames. Frames of a moved set may be missing; number 0 moves last.
    """
    if unit == SEQUENCE:
        return "f00.png" not in after.get(unit, {})
    return not blow.exchange and unit not in after
