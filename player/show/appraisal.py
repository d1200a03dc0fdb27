"""How far the picture is from the best one: measured when somebody asks, estimated beside the show."""

import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from counterlight.errors import InputError
from counterlight.pipeline.refinement import Certificate
from counterlight.pipeline.renderer import Renderer
from counterlight.pipeline.shortfall import Shortfall, Snapshot
from counterlight.show.governor import Governor
from counterlight.show.lookup import LookUp

INTERVAL_S = 0.5  # between two measurements, at least
ASKED_S = 10.0  # for which a remote that has asked where the picture stands is taken to go on asking
LAST_S = 30.0  # how long the end of a show waits for an estimate
REST = 50  # times what reading a snapshot back took: a fiftieth of the show's time


class Appraisal:
    """estimate : of a snapshot, run by a thread that then rests for as long.  clock : seconds, monotonic."""

    def __init__(self, estimate: Callable[[Snapshot], Shortfall], clock: Callable[[], float]) -> None:
        self.certificate: Certificate | None = None
        self.shortfall: Shortfall | None = None
        self._estimate, self._clock = estimate, clock
        self._measured_at = self._next_at = self._asked_at = self._began_at = float("-inf")
        self._running: LookUp[Shortfall] | None = None

    def ask(self) -> Shortfall | None:
        """What is known; it is kept up for a while from now on."""
        self._asked_at = self._clock()
        return self.shortfall

    @property
    def asked(self) -> bool:
        """Whether somebody has asked lately."""
        return self._clock() - self._asked_at < ASKED_S

    def certify(self, renderer: Renderer, max_age_s: float) -> None:
        """Measure the certificate again if what is known is older."""
        if self._clock() - self._measured_at >= max_age_s:
            self.certificate, self._measured_at = renderer.certificate(), self._clock()

    def look(self, renderer: Renderer) -> None:
        """Have what is rendered estimated, unless an estimate is under way or the last one was just begun."""
        if self._running is not None or self._clock() < self._next_at:
            return
        began = time.perf_counter()
        snapshot = renderer.snapshot()
        took_s = time.perf_counter() - began
        self._next_at = self._clock() + max(INTERVAL_S, REST * took_s)
        if snapshot is None:
            self.shortfall = None
            return
        self.certificate, self._measured_at = snapshot.certificate, self._clock()
        self._began_at = self._measured_at
        self._running = LookUp(partial(self._estimate, snapshot))

    def poll(self, governor: Governor) -> None:
        """Tell an estimate that has come; raises InputError, once, if none can be made."""
        try:
            found = None if self._running is None else self._running.result()
        except InputError:
            self._running, self._next_at = None, float("inf")
            raise
        if found is not None:
            self._running, self.shortfall = None, found
            self._next_at = max(self._next_at, 2 * self._clock() - self._began_at)
            governor.judged(found)

    def conclude(self, renderer: Renderer) -> None:
        """Wait for an estimate if there is none: the show is over."""
        if self.shortfall is None:
            self._next_at = float("-inf")
            self.look(renderer)
            with suppress(InputError):
                self.shortfall = None if self._running is None else self._running.result(LAST_S)

    def to_dict(self) -> dict[str, float | int | None]:
        """For JSON, what is known."""
        known = (self.certificate, self.shortfall)
        return {key: value for each in known if each is not None for key, value in each.to_dict().items()}

    def forget(self) -> None:
        """Another room, or another medium: what is known is of something else."""
        self.certificate = self.shortfall = self._running = None
        self._measured_at = self._next_at = float("-inf")
