"""Every command that writes, killed or refused (no space) at any step: old or new whole, clean after the next run."""

import re
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from tests.faults import KILL, REFUSE, Fault, Run, Runner
from tests.fuzz.tally import CRASHED, LEFT, READ, REFUSED, WRONG, Plan, Tally, Trial
from tests.writing_commands import COMMANDS, contents, furnish, is_whole, words_of, write_inputs

MARK = ".counterlight-partial"  # in the name of every hidden folder of a writer
SEQUENCE, CAPTURES = "f%02d.png", "made.captures"
REPORT = "made.report/"  # which tells seconds
Unit: TypeAlias = Mapping[str, bytes | None]
HOWS = (KILL, True), (KILL, False), (REFUSE, True)  # and whether folders can be exchanged


class Kills:
    """Every command, struck at every step in three ways, in random order; then again, which must succeed."""

    name, count = "kills", 60
    purpose = "commands killed or refused at a step by which something gets onto the disk"

    def run(self, plan: Plan) -> Tally:
        tally = Tally(self.name, plan)
        room = plan.scratch / "inputs" / "room"
        write_inputs(room)
        with Runner() as runner:
            bench = Bench(runner, room, plan.scratch)
            strikes = [Strike(name, at, *how) for name, clean in bench.clean.items() for at in clean.at for how in HOWS]
            order = plan.rng(self.name, 0).permutation(len(strikes))
            for index in plan.indices():
                if index < len(strikes):
                    tally.add(index, bench.trial(strikes[order[index]]))
        tally.notes["of"] = f"{len(strikes)} at {len(strikes) // len(HOWS)} steps"
        return tally


@dataclass(frozen=True)
class Strike:
    """A command, which of its steps is struck, and how."""

    command: str
    at: int
    how: str
    exchange: bool

    def __str__(self) -> str:
        return f"{self.command}, {self.how} at {self.at}{'' if self.exchange else ', folders cannot be exchanged'}"


@dataclass(frozen=True)
class Clean:
    """A command that nothing disturbs: its steps, and what it leaves; `vague` is what differs from run to run."""

    at: range
    made: Mapping[str, Unit]
    vague: frozenset[str]


def units_of(folder: Path, vague: frozenset[str]) -> dict[str, Unit]:
    """What is in a folder by what is replaced as a whole: a file, a folder, a correction map, a sequence.

    Of what is vague, only the names count.
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
    """Where commands are struck."""

    def __init__(self, runner: Runner, room: Path, scratch: Path) -> None:
        self._runner, self._room, self._scratch = runner, room, scratch
        self.clean = {name: self._undisturbed(name) for name in COMMANDS}

    def trial(self, strike: Strike) -> Trial:
        clean, out = self.clean[strike.command], self._furnished()
        before = units_of(out, clean.vague)
        begun = time.monotonic()
        struck = self._run(strike.command, out, Fault(strike.at, strike.how, exchange=strike.exchange))
        seconds = time.monotonic() - begun
        found = _struck(struck, strike, out, before, clean) or self._resumed(strike.command, out, clean)
        verdict, words = found or (REFUSED if struck.code == 2 else READ, "")
        return Trial(verdict, f"{strike}: {words}", seconds)

    def _undisturbed(self, name: str) -> Clean:
        runs, files = [], []
        for _ in range(2):
            out = self._furnished()
            runs.append(self._run(name, out, Fault()))
            files.append(contents(out))
            assert runs[-1].code == 0, runs[-1].words
        differs = {key for key in files[0].keys() | files[1].keys() if files[0].get(key) != files[1].get(key)}
        vague = frozenset(differs | {key for key in files[0] if key.startswith(REPORT)})
        return Clean(range(1, runs[0].steps + 1), units_of(out, vague), vague)

    def _resumed(self, name: str, out: Path, clean: Clean) -> tuple[str, str] | None:
        """The same command again, as somebody would after a power failure."""
        again = ["--force"] if (out / "made").exists() else []  # it was struck when its work was done
        run = self._run(name, out, Fault(), again)
        if run.code != 0:
            return CRASHED, f"the next run ended with {run.code}: {run.words}"
        hidden = [path.name for path in out.rglob("*") if MARK in path.name]
        if hidden:
            return LEFT, f"after the next run: {hidden}"
        after = units_of(out, clean.vague)
        wrong = [unit for unit, files in clean.made.items() if unit != CAPTURES and after.get(unit) != files]
        return (WRONG, f"the next run leaves another {wrong}") if wrong else None

    def _furnished(self) -> Path:
        """The same path for every run, for paths are part of what is written."""
        out = self._scratch / "out"
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        furnish(out, self._room)
        return out

    def _run(self, name: str, out: Path, fault: Fault, more: Sequence[str] = ()) -> Run:
        function, (words,) = words_of(COMMANDS[name], out, self._room)
        return self._runner.run(function, [[*words, *more]], fault)


def _struck(run: Run, strike: Strike, out: Path, before: Mapping[str, Unit], clean: Clean) -> tuple[str, str] | None:
    """What is wrong right after the strike; None if nothing is."""
    if run.code not in ((-9, 0) if strike.how == KILL else (0, 2)):
        return CRASHED, f"ended with {run.code}: {run.words}"
    if run.code == 2 and len([line for line in run.words.splitlines() if line.startswith("error")]) != 1:
        return CRASHED, f"no single line: {run.words}"
    after = units_of(out, clean.vague)
    for unit in before.keys() | clean.made.keys() | after.keys():
        complaint = _complaint(unit, after.get(unit), before.get(unit), clean.made.get(unit), out)
        if complaint and not (strike.how == KILL and _may_be_absent(unit, after, strike)):
            return WRONG, f"{unit}: {complaint}"
    hidden = [path.name for path in out.rglob("*") if MARK in path.name]
    return (LEFT, f"by a command that was refused: {hidden}") if hidden and run.code == 2 else None


def _complaint(unit: str, after: Unit | None, before: Unit | None, made: Unit | None, out: Path) -> str:
    if after in (before, made):
        return ""
    if unit == CAPTURES and after is not None:
        broken = [name for name in after if not is_whole(out, name)]
        return f"{broken} are not whole" if broken else ""
    return "gone" if after is None else "neither what it was nor what it becomes"


def _may_be_absent(unit: str, after: Mapping[str, Unit], strike: Strike) -> bool:
    """Until the next command: a folder between two renames, and frames of a set that is moved, number 0 last."""
    if unit == SEQUENCE:
        return "f00.png" not in after.get(unit, {})
    return not strike.exchange and unit not in after
