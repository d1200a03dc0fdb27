"""Measures the distance of the picture from the best picture: a certificate on request, estimates by a thread."""

import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from counterlight.errors import InputError
from counterlight.pipeline.refinement import Certificate
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.pipeline.shortfall import Shortfall, Snapshot
from counterlight.show.governor import Governor
from counterlight.show.lookup import LookUp

INTERVAL_S = 0.5  # shortest time between two measurements
ASKED_S = 10.0  # how long the estimate continues after a request by a remote
LAST_S = 30.0  # longest wait for an estimate at the end of a show
REST = 50  # pause after a snapshot, in multiples of its read-back time: 2 % of the show's time


class Appraisal:
    """Keeps the latest certificate and the latest estimated shortfall of the picture.

    estimate : estimates the shortfall of a snapshot. A thread runs it, then rests for as long as the estimate took.
    clock : seconds, monotonic.
    """

    def __init__(self, estimate: Callable[[Snapshot], Shortfall], clock: Callable[[], float]) -> None:
        self.certificate: Certificate | None = None
        self.shortfall: Shortfall | None = None
        self._estimate, self._clock = estimate, clock
        self._measured_at = self._next_at = self._asked_at = self._began_at = float("-inf")
        self._running: LookUp[Shortfall] | None = None

    def ask(self) -> Shortfall | None:
        """Return the latest estimate, None if there is none yet. Estimates continue for ASKED_S from now on."""
        self._asked_at = self._clock()
        return self.shortfall

    @property
    def asked(self) -> bool:
        """Whether a remote has asked within the last ASKED_S."""
        return self._clock() - self._asked_at < ASKED_S

    def certify(self, renderer: AnyRenderer, max_age_s: float) -> None:
        """Measure the certificate again if the present certificate is older than `max_age_s`."""
        if self._clock() - self._measured_at >= max_age_s:
            self.certificate, self._measured_at = renderer.certificate(), self._clock()

    def look(self, renderer: AnyRenderer) -> None:
        """Start an estimate of the rendered picture, unless an estimate runs or began too recently."""
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
        """Pass a finished estimate to the governor. Raises InputError, once, if no estimate can be made."""
        try:
            found = None if self._running is None else self._running.result()
        except InputError:
            self._running, self._next_at = None, float("inf")
            raise
        if found is not None:
            self._running, self.shortfall = None, found
            self._next_at = max(self._next_at, 2 * self._clock() - self._began_at)
            governor.judged(found)

    def conclude(self, renderer: AnyRenderer) -> None:
        """Wait up to LAST_S for an estimate at the end of the show, if there is none yet."""
        if self.shortfall is None:
            self._next_at = float("-inf")
            self.look(renderer)
            with suppress(InputError):
                self.shortfall = None if self._running is None else self._running.result(LAST_S)

    def to_dict(self) -> dict[str, float | int | None]:
        """Return the certificate and the estimate for JSON, as far as they are known."""
        known = (self.certificate, self.shortfall)
        return {key: value for each in known if each is not None for key, value in each.to_dict().items()}

    def forget(self) -> None:
        """Discard all results, because the room or the medium has changed.

        The next look is INTERVAL_S away, so that no measurement delays the first frames.
        """
        self.certificate = self.shortfall = self._running = None
        self._measured_at, self._next_at = float("-inf"), self._clock() + INTERVAL_S
