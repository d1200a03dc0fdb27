"""Waits for parts of a show that are not there yet, at growing intervals and without an end."""

import time
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from counterlight.command import tell
from counterlight.errors import AbsentError
from counterlight.unattended.heartbeat import WAITING, Heartbeat

RETRY_S, LONGEST_RETRY_S = 1.0, 30.0
POLL_S = 0.1

T = TypeVar("T")


def retry_s(tries: int) -> float:
    """Return the seconds to wait after `tries` earlier tries: 1, 2, 4 … 30."""
    return float(min(RETRY_S * 2 ** min(tries, 10), LONGEST_RETRY_S))


def wait_for(find: Callable[[], T], heartbeat: Heartbeat | None) -> T:
    """Return the result of `find`, which is called again whenever it raises AbsentError.

    Each reason is printed once.

    heartbeat : names the present reason as `waiting`; None to call `find` only once.
    """
    tries, reason = 0, ""
    while True:
        try:
            found = find()
        except AbsentError as error:
            if heartbeat is None:
                raise
            if str(error) != reason:
                reason = str(error)
                tell(f"waiting: {reason}")
            _rest(retry_s(tries), partial(heartbeat.beat, {WAITING: reason}))
            tries += 1
        else:
            if reason:
                tell("waiting: over")
            return found


def _rest(seconds: float, act: Callable[[], object]) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        act()
        time.sleep(POLL_S)
