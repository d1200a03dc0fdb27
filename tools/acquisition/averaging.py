"""How often each picture is captured: as often as T's error asks for, where time allows.

A camera's noise is what an acquisition cannot see beside, and it falls with the root of the captures. How much of T it
spoils is known before the scheme begins. The noise comes from black and floodlight. The size of T comes from one
picture of random pixels, half of them lit: what a camera pixel sees of it differs from half its floodlight l by

    E (s_i − l_i / 2)² = ¼ Σ_j T_ij²,

so that all camera pixels together give ‖T‖ (Hutchinson 1990, A stochastic estimator of the trace). A camera pixel sees
about m = Σ l² / ‖T‖² projector pixels, each read off a capture of its own:

    ‖δT‖² = κ Σ_i (m dark² + gain l_i) / captures.
"""

from dataclasses import dataclass

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.acquisition.plan import Level, Pattern, Reference

SEED = 19900101
AGREEMENT = 0.9  # κ: what levels, or codes, that see the same light save of the variance (0.3 to 1.3 were measured)
MOST_REPEATS = 128
UNMEASURED_S = 0.2  # of a capture, while nobody knows


@dataclass(frozen=True)
class Aim:
    """error : of T, relative (Frobenius), that noise may leave.  seconds : that repeated captures may add."""

    error: float = 0.005
    seconds: float = 1200.0


@dataclass(frozen=True)
class Averaged:
    """What was chosen.

    once : T's error by the noise of single captures.  wanted : captures of the finest pictures for the error that was
    aimed at.  most : captures of the finest pictures.  added : captures beside one of each picture.
    """

    once: float
    wanted: int
    most: int
    added: int

    @property
    def error(self) -> float:
        """Of T, by noise."""
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
    """Half of the pixels lit, each by chance; the same for everybody."""
    return np.random.default_rng(SEED).random(projector) < 0.5


def error_by_noise(room: Reference, capture: FloatArray) -> float:
    """Relative error of T by the noise of single captures; capture : of `random_pixels`."""
    light, seen = np.maximum(room.light, 0), room.above_black(capture)
    of_halves = (room.noise.sigma(light) ** 2 + room.noise.dark**2) / (4 * room.repeats)
    excess = np.sum((seen - room.light / 2) ** 2 - room.noise.sigma(seen) ** 2 - of_halves)
    square = max(4 * float(excess), np.finfo(float).tiny)
    entries = max(float(np.sum(light**2)) / square, 1.0)
    spoilt = float(np.sum(entries * room.noise.dark**2 + room.noise.gain * light))
    return float(np.sqrt(AGREEMENT * spoilt / square))


class Averaging:
    """Chooses, level by level.  once : T's error by the noise of single captures."""

    def __init__(self, aim: Aim, once: float) -> None:
        self._aim, self._once, self._left_s = aim, once, aim.seconds
        self._most, self._added = 1, 0

    @property
    def wanted(self) -> int:
        """Captures of the finest pictures for the error that is aimed at."""
        return max(1, int(np.ceil((self._once / self._aim.error) ** 2)))

    def __str__(self) -> str:
        says = f"noise: with one capture of each picture T would be off by about {100 * self._once:.2g} %"
        if self.wanted == 1:
            return says
        return (
            f"{says}; for {100 * self._aim.error:.2g} % the finest are captured {self.wanted} times where "
            f"{self._aim.seconds / 60:.3g} minutes more allow it (--averaging MINUTES, or --shots N of each)"
        )

    @property
    def done(self) -> Averaged:
        """What came of it."""
        return Averaged(self._once, self.wanted, self._most, self._added)

    def chosen(self, level: Level, each_s: float | None) -> int:
        """Captures of each of a level's pictures.  each_s : seconds of a capture, None if nobody knows."""
        wanted = min(int(np.ceil(level.share * self.wanted)), MOST_REPEATS)
        left_s = self._left_s / (1 + level.further)
        return max(1, min(wanted, 1 + int(left_s / _cost(level, each_s))))

    def take(self, level: Level, repeats: int, each_s: float | None) -> str:
        """So many are taken; says what that costs, if it costs anything."""
        if repeats == 1:
            return ""
        added_s = (repeats - 1) * _cost(level, each_s)
        self._left_s, self._most = max(self._left_s - added_s, 0.0), max(self._most, repeats)
        self._added += (repeats - 1) * len(level.patterns)
        return f"{level.name}: each of {len(level.patterns)} pictures is captured {repeats} times, {added_s:.0f} s more"


def _cost(level: Level, each_s: float | None) -> float:
    """Seconds that one capture more of each of a level's pictures takes."""
    return max(len(level.patterns), 1) * max(UNMEASURED_S if each_s is None else each_s, 1e-6)
