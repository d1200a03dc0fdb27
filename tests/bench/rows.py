"""A benchmark's result, next to the baseline of the same run."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

WARM_UP, REPEATS = 5, 40


@dataclass(frozen=True)
class Timed:
    """Seconds of this program and of the baseline, and this program's goal."""

    what: str
    seconds: float
    baseline: str = ""
    baseline_seconds: float | None = None
    goal_s: float | None = None

    def __str__(self) -> str:
        line = f"{self.what}: {self.seconds:.2f} s"
        if self.goal_s is not None:
            line += f" (goal {self.goal_s:g} s)"
        if self.baseline_seconds is not None:
            line += f"; {self.baseline} {self.baseline_seconds:.1f} s, ratio {self.baseline_seconds / self.seconds:.1f}"
        return line


def seconds(work: Callable[[], object], repeats: int = 1) -> float:
    """Returns the median of a few runs."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def median_ms(work: Callable[[], object]) -> float:
    """Returns the median of many runs after warming up."""
    for _ in range(WARM_UP):
        work()
    return 1000 * seconds(work, REPEATS)
