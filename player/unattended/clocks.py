"""Estimates how far another machine's clock is ahead of the local clock, from questions and answers.

A question leaves at a, and its answer, which holds the other clock's time b, arrives at c. If both directions take
equally long, the other clock is ahead by b − (a + c) / 2. In any case this is right within ± (c − a) / 2 (Cristian
1989). Delays come in bursts, so the quickest round trips are the most accurate. The estimate is the median of the
quickest quarter of the last 32 round trips.
"""

from collections import deque
from statistics import median

KEPT, QUICKEST = 32, 4  # round trips kept; the quickest one in QUICKEST counts
LEAST = 5  # round trips before an estimate is made


class ClockOffset:
    def __init__(self) -> None:
        self._trips: deque[tuple[float, float]] = deque(maxlen=KEPT)  # duration and offset of each trip

    def add(self, asked_s: float, theirs_s: float, answered_s: float) -> None:
        """Add a round trip.

        asked_s : local time of the question.
        theirs_s : the other clock's time in the answer.
        answered_s : local time of the answer.
        """
        self._trips.append((answered_s - asked_s, theirs_s - (asked_s + answered_s) / 2))

    def forget(self) -> None:
        """Discard all round trips, because the other clock has changed."""
        self._trips.clear()

    @property
    def seconds(self) -> float | None:
        """The other clock's time minus the local time. None before LEAST round trips."""
        if len(self._trips) < LEAST:
            return None
        return median(offset for _, offset in self._quickest())

    @property
    def round_trip_s(self) -> float | None:
        """The slowest of the counted round trips. `seconds` is right within half of it if both clocks run evenly."""
        return self._quickest()[-1][0] if self._trips else None

    def _quickest(self) -> list[tuple[float, float]]:
        return sorted(self._trips)[: max(len(self._trips) // QUICKEST, 1)]
