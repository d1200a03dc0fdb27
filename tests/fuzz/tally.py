"""The plan of a campaign, its verdicts, and the sum of its trials."""

import json
import shlex
import sys
import time
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

READ, REFUSED = "read", "refused"  # both verdicts are correct: accepted, or refused in one line
CRASHED, HUNG, GREEDY, WRONG, LEFT = "crashed", "hung", "greedy", "silently wrong", "left behind"
FAULTS = CRASHED, HUNG, GREEDY, WRONG, LEFT
HANG_S = 5.0  # longest allowed time of a trial
MOST_BYTES = 384 << 20  # memory allowed for a file of a few kilobytes


@dataclass(frozen=True)
class Trial:
    """A trial's verdict, message and cost in seconds and in bytes above the process's earlier memory.

    prompt : whether the trial must take less than HANG_S. A whole command may take longer.
    """

    verdict: str
    words: str = ""
    seconds: float = 0.0
    peak: int = 0
    prompt: bool = True

    def checked(self) -> "Trial":
        """Return the same trial, or a fault if it cost too much."""
        if self.verdict in FAULTS:
            return self
        if self.prompt and self.seconds > HANG_S:
            return Trial(HUNG, f"{self.seconds:.1f} s; {self.words}", self.seconds, self.peak)
        if self.peak > MOST_BYTES:
            return Trial(GREEDY, f"{self.peak >> 20} MiB; {self.words}", self.seconds, self.peak)
        return self


@dataclass(frozen=True)
class Plan:
    """The trials of a campaign: `first` to `first + count`, not after `until` (time.monotonic).

    scratch : an empty folder for this campaign.
    evidence : folder for inputs of faults, by campaign and index.
    """

    seed: int
    count: int
    scratch: Path
    evidence: Path
    first: int = 0
    until: float = float("inf")

    def indices(self) -> Iterator[int]:
        for index in range(self.first, self.first + self.count):
            if time.monotonic() > self.until:
                return
            yield index

    def rng(self, campaign: str, index: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, zlib.crc32(campaign.encode()), index])


class Campaign(Protocol):
    """A kind of trial.

    name : on the command line.
    count : trials of a run of a few minutes.
    purpose : one line for --help.
    """

    name: str
    count: int
    purpose: str

    def run(self, plan: Plan) -> "Tally": ...


@dataclass
class Tally:
    """The sum of a campaign's trials, and the places of the inputs of its faults."""

    campaign: str
    plan: Plan
    verdicts: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    peak: int = 0
    findings: list[dict[str, Any]] = field(default_factory=list)
    notes: dict[str, Any] = field(default_factory=dict)

    @property
    def tried(self) -> int:
        return self.verdicts.total()

    @property
    def faults(self) -> int:
        return sum(self.verdicts[verdict] for verdict in FAULTS)

    def add(self, index: int, trial: Trial, inputs: Mapping[str, bytes] | None = None) -> None:
        trial = trial.checked()
        self.verdicts[trial.verdict] += 1
        self.slowest_s, self.peak = max(self.slowest_s, trial.seconds), max(self.peak, trial.peak)
        if trial.verdict in FAULTS:
            self._keep(index, trial, inputs or {})

    def line(self) -> str:
        counts = "".join(f"{self.verdicts[verdict]:6} {verdict}" for verdict in (REFUSED, *FAULTS))
        notes = "".join(f", {name} {value}" for name, value in self.notes.items())
        cost = f"  peak {self.peak / 2**20:.0f} MiB, slowest {self.slowest_s:.2f} s{notes}"
        return f"{self.campaign:13}{self.tried:6} tried{counts}{cost}"

    def facts(self) -> dict[str, Any]:
        counts = {verdict: self.verdicts[verdict] for verdict in (READ, REFUSED, *FAULTS)}
        costs = {"slowest_s": round(self.slowest_s, 3), "peak_bytes": self.peak}
        return {"tried": self.tried, **counts, **costs, **self.notes, "findings": self.findings}

    def _keep(self, index: int, trial: Trial, inputs: Mapping[str, bytes]) -> None:
        """Keep the inputs, and the command that repeats the trials."""
        folder = self.plan.evidence / f"{self.campaign}-{self.plan.seed}-{index}"
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in inputs.items():
            (folder / Path(name).name).write_bytes(content)
        again = f"python -m tests.fuzz {self.campaign} --seed {self.plan.seed} --only {index}"
        finding = {"index": index, "verdict": trial.verdict, "words": trial.words, "again": again}
        (folder / "finding.json").write_text(json.dumps(finding, indent=1))
        self.findings.append(finding)
        print(f"{trial.verdict}: {trial.words[:600]}\n    {again}\n    {shlex.quote(str(folder))}", file=sys.stderr)
