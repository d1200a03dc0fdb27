"""Reader with every fault that a reader may have; the warden must detect each.

The module imports little of the product, because every process that a fault ends is replaced by a new interpreter.
"""

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzz.tally import CRASHED, GREEDY, HUNG, MOST_BYTES, READ, REFUSED, WRONG, Plan, Trial
from tests.fuzz.warden import Case, FileCampaign

SEED = 7


def complain(verdict: str) -> Trial:
    print("Traceback (most recent call last): …", file=sys.stderr, flush=True)
    return Trial(verdict)


def touch_much() -> Trial:
    return Trial(READ if bytearray(b"x") * (MOST_BYTES + (64 << 20)) else WRONG)


DEEDS: tuple[tuple[Callable[[], object], str], ...] = (
    (lambda: Trial(READ), READ),
    (lambda: Trial(REFUSED), REFUSED),
    (lambda: Trial(WRONG, "accepted"), WRONG),
    (lambda: int("no number"), CRASHED),
    (os.abort, CRASHED),
    (lambda: complain(READ), CRASHED),
    (lambda: time.sleep(60), HUNG),
    (touch_much, GREEDY),
    (lambda: Trial(READ), READ),
)


class Faulty(FileCampaign):
    """Reader with every fault that a reader may have; its input selects the fault."""

    name, count, purpose, hang_s = "faulty", len(DEEDS), "for a test", 2.0

    def furnish(self, folder: Path) -> None: ...

    def open(self, folder: Path) -> None: ...

    def draw(self, rng: np.random.Generator) -> Case:
        return Case({"input": rng.bytes(4)})

    def judge(self, case: Case) -> Trial:
        inputs = [Plan(SEED, 0, Path(), Path()).rng(self.name, index).bytes(4) for index in range(len(DEEDS))]
        trial = DEEDS[inputs.index(case.files["input"])][0]()
        assert isinstance(trial, Trial)
        return trial
