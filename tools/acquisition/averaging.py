"""Choose how often each picture is captured, from the error allowed in T and the time allowed for the acquisition.

A camera's noise falls with the square root of the number of captures. The error of T by noise is known before
the scheme begins. The noise comes from black and floodlight. The size of T comes from one picture of random pixels,
half of them lit. The light s of a camera pixel in that picture differs from half its floodlight l by

    E (s_i − l_i / 2)² = ¼ Σ_j T_ij²,

so that all camera pixels together give ‖T‖ (Hutchinson 1990, A stochastic estimator of the trace). A camera pixel sees
about m = Σ l² / ‖T‖² projector pixels, each measured by a separate capture:

    ‖δT‖² = κ Σ_i (m dark² + gain l_i) / captures.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.acquisition.pace import Pace
from counterlight.tools.acquisition.plan import Expected, Level, Pattern, Reference

SEED = 19900101
AGREEMENT = 0.9  # κ: share of the variance that remains after levels or codes are combined (0.3 to 1.3 measured)
MOST_REPEATS, FINER = 128, 8
SETTLED_S = 60.0  # seconds; the first level that ends later settles the length of the acquisition
# the length may be between these shares of the settled length when the number of captures is adjusted
TOLERATED = 0.95, 1.25


@dataclass(frozen=True)
class Aim:
    """Limits of an acquisition.

    error : relative error (Frobenius) that noise may leave in T.
    seconds : duration of the whole acquisition.
    """

    error: float = 0.005
    seconds: float = 600.0


@dataclass(frozen=True)
class Averaged:
    """The numbers of captures that were chosen.

    once : relative error of T by the noise of single captures.
    wanted : captures of the finest pictures that reach the allowed error.
    most : captures of the finest pictures that were taken.
    added : captures beyond the first of each picture.
    """

    once: float
    wanted: int
    most: int
    added: int

    @property
    def error(self) -> float:
        """Relative error of T by noise."""
        return self.once / float(np.sqrt(self.most))

    def __str__(self) -> str:
        if self.wanted == 1:
            return f"noise: it leaves T with an error of about {100 * self.once:.2g} %, each picture captured once"
        more = "" if self.most >= self.wanted else f"; {self.wanted} times were wanted: more light, or more --averaging"
        return (
            f"noise: it leaves T with an error of about {100 * self.error:.2g} %, the finest pictures captured "
            f"{self.most} times, {self.added} captures more than one of each ({100 * self.once:.2g} %){more}"
        )


def random_pixels(projector: tuple[int, int]) -> Pattern:
    """Returns a pattern with each pixel lit with probability 1/2; the seed is fixed."""
    return np.random.default_rng(SEED).random(projector) < 0.5


def error_by_noise(room: Reference, capture: FloatArray) -> float:
    """Returns the relative error of T by the noise of single captures; `capture` shows `random_pixels`."""
    light, seen = np.maximum(room.light, 0), room.above_black(capture)
    of_halves = (room.noise.sigma(light) ** 2 + room.noise.dark**2) / (4 * room.repeats)
    excess = np.sum((seen - room.light / 2) ** 2 - room.noise.sigma(seen) ** 2 - of_halves)
    square = max(4 * float(excess), np.finfo(float).tiny)
    entries = max(float(np.sum(light**2)) / square, 1.0)
    spoilt = float(np.sum(entries * room.noise.dark**2 + room.noise.gain * light))
    return float(np.sqrt(AGREEMENT * spoilt / square))


class Averaging:
    """Chooses the number of captures of each picture, level by level.

    once : relative error of T by the noise of single captures.
    pace : seconds per capture so far.
    until_s : time by which all captures should exist, in seconds of the acquisition as `pace` plans them.
    """

    def __init__(self, aim: Aim, once: float, pace: Pace, until_s: float) -> None:
        self._aim, self._once, self._pace, self._until_s = aim, once, pace, until_s
        self._settled_s: float | None = None
        self._finest, self._most, self._added = float(self.wanted), 1, 0

    @property
    def wanted(self) -> int:
        """Captures of the finest pictures that reach the allowed error."""
        return int(np.clip(np.ceil((self._once / self._aim.error) ** 2), 1, MOST_REPEATS))

    @property
    def done(self) -> Averaged:
        """The numbers of captures so far."""
        return Averaged(self._once, self.wanted, self._most, self._added)

    def captures(self, expected: Expected) -> int:
        """Returns the captures of all pictures of a level, as planned last."""
        return expected.pictures * self._repeats(expected.share, self._finest)

    def plan(self, levels: Sequence[Expected]) -> None:
        """Choose how often the finest pictures are captured, given the levels to come.

        The finest pictures are captured as often as wanted, or as often as time allows. The first level that ends after
        SETTLED_S settles the length of the acquisition. If later levels have more pictures than expected, each is
        captured less often; if they have fewer, more often.
        """
        self._finest = min(self.wanted, self._fitting(levels, self._until_s))
        if self._settled_s is not None and self.wanted > 1:
            least, most = (self._fitting(levels, min(self._settled_s * share, self._until_s)) for share in TOLERATED)
            self._finest = min(max(float(self.wanted), least), most)
        elif self._end_s(levels[:1], self._finest) >= SETTLED_S:
            self._settled_s = self._end_s(levels, self._finest)

    def chosen(self, level: Level) -> int:
        """Returns how often each picture of a level is captured."""
        self.plan([level.expected, *level.later])
        return self._repeats(level.share, self._finest)

    def take(self, level: Level, repeats: int) -> str:
        """Count the captures of a level; returns a line of text if pictures are captured several times."""
        if level.share == 1:  # black before the scheme, and the finest pictures at the end of the scheme
            self._most = repeats
        self._added += (repeats - 1) * len(level.patterns)
        return "" if repeats == 1 else f"{level.name}: {len(level.patterns)} pictures, captured {repeats} times each"

    def _fitting(self, levels: Sequence[Expected], until_s: float) -> float:
        """Returns how often the finest pictures can be captured before `until_s`, at least 1.

        The count has steps of 1 / FINER, because coarser pictures take a rounded-up share of it, each at another step.
        """
        steps = range(FINER * MOST_REPEATS, FINER, -1)
        return next((step / FINER for step in steps if self._end_s(levels, step / FINER) <= until_s), 1.0)

    def _end_s(self, levels: Sequence[Expected], finest: float) -> float:
        """Returns when these levels end, in seconds of the acquisition."""
        repeats = [self._repeats(level.share, finest) for level in levels]
        fresh = sum(level.pictures for level in levels)
        captures = sum(level.pictures * each for level, each in zip(levels, repeats, strict=True))
        return self._pace.planned_s + self._pace.plan_s(fresh, captures)

    def _repeats(self, share: float, finest: float) -> int:
        return max(1, int(np.ceil(share * finest)))
