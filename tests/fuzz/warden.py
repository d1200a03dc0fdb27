"""Files are judged in a separate process, which may crash, hang or use up memory.

The warden detects this and continues.

python -m tests.fuzz.warden MODULE:CLASS FOLDER      a prisoner: reads trials from its input, a JSON line each
"""

import importlib
import json
import os
import select
import subprocess
import sys
import tempfile
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from tests.fuzz.tally import CRASHED, HANG_S, HUNG, Plan, Tally, Trial
from tests.programs import ROOT

PATIENCE_S = 120.0  # seconds for the imports of a prisoner on a busy machine
FRESH_AFTER = 500  # trials after which a prisoner is replaced; another campaign tests long-term memory


@dataclass(frozen=True)
class Case:
    """Files of a trial by name, and the way in which they are tried."""

    files: Mapping[str, bytes]
    how: str = ""


class FileCampaign(ABC):
    """Trials that are files: `draw` makes them from random numbers, `judge` returns the product's reaction."""

    name: str
    count: int
    purpose: str
    hang_s = HANG_S

    @abstractmethod
    def furnish(self, folder: Path) -> None:
        """Create once the samples from which files are drawn."""

    @abstractmethod
    def open(self, folder: Path) -> None:
        """Prepare for `draw` and `judge`; called in every process that runs one of them."""

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Case: ...

    @abstractmethod
    def judge(self, case: Case) -> Trial:
        """Return the product's reaction, and the peak memory of its children. An exception counts as a crash."""

    def run(self, plan: Plan) -> Tally:
        tally = Tally(self.name, plan)
        self.furnish(plan.scratch)
        self.open(plan.scratch)
        with Prisoner(self, plan) as prisoner:
            for index in plan.indices():
                trial = prisoner.trial(index)
                if trial.verdict == HUNG:  # try again, because the machine may have been busy
                    trial = prisoner.trial(index)
                tally.add(index, trial, self.draw(plan.rng(self.name, index)).files)
        return tally


class Prisoner:
    """A process that judges. It is killed when it hangs, and replaced when it is dead or old."""

    def __init__(self, campaign: FileCampaign, plan: Plan) -> None:
        self._campaign, self._plan = campaign, plan
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 (closed with the prisoner)
        self._process: subprocess.Popen[bytes] | None = None
        self._age = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()
        self._errors.close()

    def trial(self, index: int) -> Trial:
        if self._age >= FRESH_AFTER:
            self._end()
        process = self._process or self._start()
        self._age += 1
        begun, heard = time.monotonic(), self._errors.seek(0, os.SEEK_END)
        answer = self._ask(process, {"seed": self._plan.seed, "index": index}, self._campaign.hang_s)
        seconds = time.monotonic() - begun
        if answer is None:
            self._end()
            return Trial(HUNG, f"no answer after {seconds:.1f} s", seconds)
        if not answer:
            code = process.wait()
            self._end()
            return Trial(CRASHED, f"ended with {code}: {self._said(heard)}", seconds)
        trial = Trial(**answer)
        said = self._said(heard)
        return Trial(CRASHED, said, trial.seconds, trial.peak) if "Traceback" in said else trial

    def _start(self) -> subprocess.Popen[bytes]:
        kind = type(self._campaign)
        words = [sys.executable, "-m", "tests.fuzz.warden", f"{kind.__module__}:{kind.__name__}"]
        self._process = subprocess.Popen(
            [*words, str(self._plan.scratch)],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            start_new_session=True,
        )
        self._age = 0
        assert self._ask(self._process, {}, PATIENCE_S), self._said(0)
        return self._process

    def _ask(
        self, process: subprocess.Popen[bytes], request: Mapping[str, Any], within_s: float
    ) -> dict[str, Any] | None:
        """Return the prisoner's answer; empty if the prisoner is dead, None after the time limit."""
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(BrokenPipeError):
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
        if not select.select([process.stdout], [], [], within_s)[0]:
            return None
        line = process.stdout.readline()
        return dict(json.loads(line)) if line else {}

    def _said(self, since: int) -> str:
        self._errors.seek(since)
        return self._errors.read().decode(errors="replace")[-2000:]

    def _end(self) -> None:
        if self._process is not None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, 9)  # the prisoner and its children
            self._process.communicate()
            self._process = None


def _serve(campaign: FileCampaign, folder: Path) -> None:
    """Answer one trial after another, inside the prisoner. Printed output is dropped; complaints go to the warden."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    campaign.open(folder)
    for line in sys.stdin:
        request = json.loads(line)
        report = (
            asdict(_tried(campaign, Plan(request["seed"], 1, folder, folder), request["index"]))
            if request
            else {"ready": 1}
        )
        print(json.dumps(report), file=answers, flush=True)


def _tried(campaign: FileCampaign, plan: Plan, index: int) -> Trial:
    case = campaign.draw(plan.rng(campaign.name, index))
    before, begun = _forget_peak(), time.monotonic()
    try:
        trial = campaign.judge(case)
    except Exception as error:
        places = "".join(traceback.format_tb(error.__traceback__)[-3:])
        trial = Trial(CRASHED, f"{error!r}\n{places}")
    peak = max(trial.peak, resident_bytes(peak=True) - before)
    return replace(trial, words=f"{case.how}: {trial.words}", seconds=time.monotonic() - begun, peak=peak)


def _forget_peak() -> int:
    """Return the resident bytes, and reset the kernel's peak to them."""
    Path("/proc/self/clear_refs").write_text("5")
    return resident_bytes()


def resident_bytes(pid: int | str = "self", *, peak: bool = False) -> int:
    """Return the resident bytes of a process; 0 for a process that has gone."""
    with suppress(OSError, IndexError):
        status = Path(f"/proc/{pid}/status").read_text()
        return int(status.partition("VmHWM:" if peak else "VmRSS:")[2].split()[0]) << 10
    return 0


if __name__ == "__main__":
    module, _, name = sys.argv[1].partition(":")
    _serve(getattr(importlib.import_module(module), name)(), Path(sys.argv[2]))
