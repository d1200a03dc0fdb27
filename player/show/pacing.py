"""Keeps the frame rate even on a slow machine by showing only every second frame, every third frame, and so on."""

import math
from collections import deque
from statistics import median

WINDOW_S = 1.0  # length of the window in which a rate is judged
FEWEST = 4  # fewest frames in a window that is judged
MISSED = 0.1  # share of missed groups that makes a rate too high
GAPS = 2  # fewest gaps in a window; a single gap of any length is ignored
LATE_WINDOWS = 2  # late windows in a row that make a rate too high
SHARE = 0.9  # share of the frame interval that drawing may take before a higher rate is tried
# windows without delay before a higher rate is tried; each failed try doubles their number
FIRST_PATIENCE, MOST_PATIENCE = 2, 128


class Pace:
    """Chooses `every` = n, so that the player shows every n-th frame. n is the smallest that can be drawn in time.

    Frames are counted in groups of `every`. A group is missed if none of its frames was shown.

    interval_s : time between two frames of the medium.
    every : initial value.
    """

    def __init__(self, interval_s: float, every: int = 1) -> None:
        self.interval_s, self.every = interval_s, every
        self._patience, self._in_time, self._late, self._tried = FIRST_PATIENCE, 0, 0, False
        self._drawn_s = deque[float](maxlen=2 * FEWEST)
        self._first: int | None = None
        self._last = self._count = self._gaps = 0
        self._began_s = 0.0

    def shown(self, time_s: float, at_s: float, drawn_s: float, *, may_slow: bool) -> bool:
        """Count a shown frame, and return whether `every` has changed.

        time_s : time of the frame in the medium.
        at_s : clock time.
        drawn_s : seconds that drawing the frame took.
        may_slow : whether nothing else can make drawing faster, so that the rate may fall.
        """
        group = self.group(time_s)
        self._drawn_s.append(drawn_s)
        if self._first is None or group < self._last:
            self._begin(group, at_s)
            return False
        self._gaps += group > self._last + 1
        self._last, self._count = group, self._count + 1
        if self._count < FEWEST or at_s - self._began_s < WINDOW_S:
            return False
        chosen = self._chosen((group - self._first) / self._count, may_slow)
        changed, self.every = chosen != self.every, chosen
        self._begin(self.group(time_s), at_s)
        return changed

    @property
    def shown_s(self) -> float:
        """Seconds from one shown frame to the next shown frame, in the medium."""
        return self.every * self.interval_s

    def group(self, time_s: float) -> int:
        """Return the number of the group that a frame belongs to."""
        return math.floor(time_s / self.shown_s + 1e-3)

    def next_s(self, time_s: float) -> float:
        """Return the time in the medium at which the next group begins."""
        return (self.group(time_s) + 1) * self.shown_s

    def _chosen(self, groups_per_frame: float, may_slow: bool) -> int:
        if self._gaps >= GAPS and groups_per_frame > 1 + MISSED:
            return self._slowed(groups_per_frame) if may_slow else self.every
        self._in_time, self._late = self._in_time + 1, 0
        if self._in_time < self._patience:
            return self.every
        if self._tried:
            self._patience, self._tried = FIRST_PATIENCE, False
        possible = max(math.ceil(median(self._drawn_s) / (SHARE * self.interval_s)), 1)
        if possible >= self.every:
            return self.every
        self._in_time, self._tried = 0, True
        return possible

    def _slowed(self, groups_per_frame: float) -> int:
        self._in_time, self._late = 0, self._late + 1
        if self._late < LATE_WINDOWS:
            return self.every
        if self._tried:
            self._patience = min(2 * self._patience, MOST_PATIENCE)
        self._late, self._tried = 0, False
        return math.ceil(self.every * groups_per_frame - MISSED)

    def _begin(self, group: int, at_s: float) -> None:
        self._first, self._last, self._began_s = group, group, at_s
        self._count = self._gaps = 0
