"""How long captures take, and how long the rest of an acquisition will.

A camera waits for a new picture, and not for a picture that stands already, so that the two are timed apart.
"""

import time
from collections.abc import Callable
from typing import TypeAlias

Clock: TypeAlias = Callable[[], float]

LEAST_S = 1 / 7  # seconds of an exposure in plans: a faster camera takes as many exposures and is done earlier
CHECKS_S = 60.0  # allowed for the checks before an acquisition
COMPUTING_S = 20.0  # of reading, solving, writing and reporting
COMPUTING_S_A_PIXEL = 7.5e-4  # of the camera, in addition: a whole room of 480x270 takes 2 minutes


class Pace:
    """Seconds of a capture, of new pictures and of those that stand already.

    exposures : of a capture.  clock : seconds.
    """

    def __init__(self, exposures: int, clock: Clock = time.monotonic) -> None:
        self._least_s, self._clock, self._start = exposures * LEAST_S, clock, clock()
        self._seconds, self._captures = [0.0, 0.0], [0, 0]
        self._resumed = [0, 0]

    def took(self, seconds: float, *, again: bool) -> None:
        """A capture was taken.  again : of a picture that stood already."""
        self._seconds[again] += seconds
        self._captures[again] += 1

    def resumed(self, pictures: int, captures: int) -> None:
        """Captures were there already: plans count them like others."""
        self._resumed[False] += pictures
        self._resumed[True] += captures - pictures

    @property
    def computed_s(self) -> float:
        """Seconds so far in which no capture was taken."""
        return self._clock() - self._start - sum(self._seconds)

    @property
    def planned_s(self) -> float:
        """Seconds so far as plans count them."""
        fresh, again = (taken + there for taken, there in zip(self._captures, self._resumed, strict=True))
        return self.plan_s(fresh, fresh + again)

    def seconds(self, pictures: int, captures: int) -> float:
        """Of so many captures of so many pictures, at the pace so far."""
        return pictures * self._each_s(again=False) + (captures - pictures) * self._each_s(again=True)

    def plan_s(self, pictures: int, captures: int) -> float:
        """The same for plans: no camera is faster than LEAST_S, so that its pace does not decide what is captured."""
        fresh, again = (max(self._each_s(again=each), self._least_s) for each in (False, True))
        return pictures * fresh + (captures - pictures) * again

    def _each_s(self, *, again: bool) -> float:
        """Of a capture; if none was taken so far, of the other kind."""
        for kind in (again, not again):
            if self._captures[kind]:
                return self._seconds[kind] / self._captures[kind]
        return self._least_s


def computing_s(camera_pixels: int) -> float:
    """Seconds of reading captures, solving for T, and reporting; about, on two cores."""
    return COMPUTING_S + COMPUTING_S_A_PIXEL * camera_pixels


def duration(seconds: float) -> str:
    """`45 s`, `3 min 20 s` or `2 h 5 min`."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes, tens = divmod(round(seconds / 10), 6)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60} min"
    return f"{minutes} min {10 * tens} s" if tens else f"{minutes} min"
