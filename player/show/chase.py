"""A show that goes where timecode is: a Follower's leader whose wire is a sound input (docs/in_step.md)."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from statistics import median

import numpy as np
from numpy.typing import NDArray

from counterlight.unattended.cues import Cue, Heard
from counterlight.unattended.timecode import Passed, Timecode, TimecodeReader, nearest_rate

LOST_S = 0.5  # without a frame: whoever plays the timecode has stopped
BLOCKS = 64  # whose arrival says when a sample was heard


class Chase:
    """start : the timecode at which the first medium begins.  items : how many media there are.

    A list's media begin an hour of timecode after one another. `take` may be called by any one thread.
    """

    def __init__(
        self,
        samples_a_second: float,
        start: Timecode,
        items: Callable[[], int],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._samples_a_second, self._start, self._items, self._clock = samples_a_second, start, items, clock
        self._reader, self._taken = TimecodeReader(samples_a_second), 0
        self._begins: deque[float] = deque(maxlen=BLOCKS)  # when sample 0 was heard, by each block
        self._rate: Fraction | None = None
        self._cue = Cue(0, 0.0, clock(), paused=True)
        self._code: Timecode | None = None

    @property
    def heard(self) -> Heard:
        """Where the show is to be: on its first frame until timecode has come, and where it stopped when it has."""
        cue = self._cue
        if cue.moving and self._clock() - cue.at_s > LOST_S:
            cue = replace(cue, paused=True, moving=False)
        return Heard(cue, 0.0, None, None if self._code is None else str(self._code))

    def take(self, samples: NDArray[np.float32], heard_s: float) -> None:
        """Samples that follow those before, and when the first of them was heard, by the clock."""
        self._begins.append(heard_s - self._taken / self._samples_a_second)
        self._taken += len(samples)
        passed = self._reader.feed(samples)
        if passed:
            self._pass(passed[-1])

    def _pass(self, last: Passed) -> None:
        if last.samples is not None:
            self._rate = nearest_rate(self._samples_a_second / last.samples, drop=last.code.drop) or self._rate
        if self._rate is None:
            return
        a_second = round(self._rate)
        start = replace(self._start, drop=last.code.drop)
        count = last.code.count(a_second) + 1 - start.count(a_second)  # the next frame begins as this one ends
        ended_s = median(self._begins) + last.end / self._samples_a_second
        self._code = last.code
        if count < 0:
            self._cue = Cue(0, 0.0, ended_s, paused=True)
            return
        hour = Timecode(1, 0, 0, 0, last.code.drop).count(a_second)
        item, into = divmod(count, hour) if self._items() > 1 else (0, count)
        self._cue = Cue(item, float(into / self._rate), ended_s, moving=True)
