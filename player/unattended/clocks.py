"""How far another machine's clock is ahead of ours, told from questions and answers.

A question leaves at a, its answer, which holds the other clock's time b, comes at c: if both took as long, the other
clock is ahead by b − (a + c) / 2, and whatever they took, by that within ± (c − a) / 2 (Cristian 1989). Delay comes in
bursts, so that the quickest are nearest to the truth: of the last 32 round trips the quickest quarter counts, and of
these the median.
"""

from collections import deque
from statistics import median

KEPT, QUICKEST = 32, 4  # round trips, one of so many counts
LEAST = 5  # round trips before anything is said


class ClockOffset:
    def __init__(self) -> None:
        self._trips: deque[tuple[float, float]] = deque(maxlen=KEPT)  # how long one took, offset

    def add(self, asked_s: float, theirs_s: float, answered_s: float) -> None:
        """A round trip: when it was asked and answered by our clock, and what theirs said."""
        self._trips.append((answered_s - asked_s, theirs_s - (asked_s + answered_s) / 2))

    def forget(self) -> None:
        """It is another clock from now on."""
        self._trips.clear()

    @property
    def seconds(self) -> float | None:
        """Theirs less ours; None while too little is known."""
        if len(self._trips) < LEAST:
            return None
        return median(offset for _, offset in self._quickest())

    @property
    def round_trip_s(self) -> float | None:
        """Of those that count, the slowest: `seconds` is right within half of it, as long as clocks keep their pace."""
        return self._quickest()[-1][0] if self._trips else None

    def _quickest(self) -> list[tuple[float, float]]:
        return sorted(self._trips)[: max(len(self._trips) // QUICKEST, 1)]
