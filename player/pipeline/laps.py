"""How long each stage of a frame takes: every lap waits for the device, so only some frames are timed."""

import time
from collections.abc import Callable

STAGES = ("linear", "place", "start", "steps", "view", "encode")


class Laps:
    """seconds : of each of STAGES that the frame timed last went through.

    linear : decoded to linear light.  place : into the camera's view, less ambient light.  start : T⁺ b, or another
    start.  steps : of refinement, all together.  view : what else is seen.  encode : to 8 bit.
    """

    def __init__(self, finish: Callable[[], None]) -> None:
        self.seconds: dict[str, float] = {}
        self._finish, self._running, self._since = finish, False, 0.0

    def begin(self, *, timed: bool) -> None:
        self._running = timed
        if timed:
            self._finish()
            self.seconds, self._since = {}, time.perf_counter()

    def end(self, stage: str) -> None:
        """A stage is done."""
        if self._running:
            self._finish()
            now = time.perf_counter()
            self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._since
            self._since = now
