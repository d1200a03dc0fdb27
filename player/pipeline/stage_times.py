"""Times the stages of a frame. Each measurement waits for the device, so only some frames are timed."""

import time
from collections.abc import Callable

STAGES = ("linear", "place", "start", "steps", "view", "encode")


class StageTimes:
    """Seconds per stage (STAGES) of the frame that was timed last.

    linear : decoding to linear light.
    place : placing in the camera's view, and subtracting ambient light.
    start : T⁺ b, or another start.
    steps : all steps of refinement.
    view : other passes for the shown view.
    encode : encoding to 8 bit.
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
        """Record the end of a stage."""
        if self._running:
            self._finish()
            now = time.perf_counter()
            self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._since
            self._since = now
