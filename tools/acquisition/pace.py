"""Estimate how long captures and the rest of an acquisition take.

Captures of new and of repeated pictures are timed separately, because only a new picture must first reach the camera.
"""

import time
from collections.abc import Callable
from typing import TypeAlias

Clock: TypeAlias = Callable[[], float]

# shortest time per exposure in plans, in seconds; a faster camera takes as many exposures and finishes earlier
LEAST_S = 1 / 7
CHECKS_S = 60.0  # seconds allowed for the checks before an acquisition
COMPUTING_S = 20.0  # seconds of reading, solving, writing and reporting
COMPUTING_S_A_PIXEL = 7.5e-4  # seconds per camera pixel, in addition; a whole room of 480x270 takes 2 minutes


class Pace:
    """Seconds per capture, for new and for repeated pictures.

    exposures : exposures per capture.
    clock : returns seconds.
    """

    def __init__(self, exposures: int, clock: Clock = time.monotonic) -> None:
        self._least_s, self._clock, self._start = exposures * LEAST_S, clock, clock()
        self._seconds, self._captures = [0.0, 0.0], [0, 0]
        self._resumed = [0, 0]

    def took(self, seconds: float, *, again: bool) -> None:
        """Record a capture; `again` means that the picture was already shown."""
        self._seconds[again] += seconds
        self._captures[again] += 1

    def resumed(self, pictures: int, captures: int) -> None:
        """Record captures that were already stored, so that plans count them too."""
        self._resumed[False] += pictures
        self._resumed[True] += captures - pictures

    @property
    def computed_s(self) -> float:
        """Seconds so far in which no capture was taken."""
        return self._clock() - self._start - sum(self._seconds)

    @property
    def planned_s(self) -> float:
        """Seconds so far, at the pace that plans assume."""
        fresh, again = (taken + there for taken, there in zip(self._captures, self._resumed, strict=True))
        return self.plan_s(fresh, fresh + again)

    def seconds(self, pictures: int, captures: int) -> float:
        """Returns the seconds that `captures` captures of `pictures` pictures take at the pace so far."""
        return pictures * self._each_s(again=False) + (captures - pictures) * self._each_s(again=True)

    def plan_s(self, pictures: int, captures: int) -> float:
        """Like `seconds`, but never faster than LEAST_S, so that a fast camera does not change what is captured."""
        fresh, again = (max(self._each_s(again=each), self._least_s) for each in (False, True))
        return pictures * fresh + (captures - pictures) * again

    def _each_s(self, *, again: bool) -> float:
        """Returns the seconds per capture of one kind; if none was taken, of the other kind."""
        for kind in (again, not again):
            if self._captures[kind]:
                return self._seconds[kind] / self._captures[kind]
        return self._least_s


def computing_s(camera_pixels: int) -> float:
    """Returns about how many seconds it takes to read captures, solve for T and report, on two cores."""
    return COMPUTING_S + COMPUTING_S_A_PIXEL * camera_pixels


def duration(seconds: float) -> str:
    """Returns a text such as `45 s`, `3 min 20 s` or `2 h 5 min`."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes, tens = divmod(round(seconds / 10), 6)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60} min"
    return f"{minutes} min {10 * tens} s" if tens else f"{minutes} min"
