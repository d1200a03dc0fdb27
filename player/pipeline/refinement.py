"""Refinement: a few steps per frame towards the best picture that the projector can show (docs/refinement.md).

Per colour channel,

    min ½ Σ w (T p − b)² + ½ pᵀP p,  0 ≤ p ≤ 1,        b = c − e,

w weights camera pixels by trust, and P is a prior (player/maps/prior.py). As T ≥ 0, TᵀWT ≼ diag(d) with d = TᵀW T·1, so
a step of s = 1/(d + the prior's bound) never overshoots:

    q = clamp(y + s (TᵀW(b − T y) − P y)),   y ← q + β (q − p) + γ (q − y),   p ← q.

β is Nesterov's momentum; γ is the over-relaxation of the optimised gradient method (Kim and Fessler 2016). Both follow
a fixed schedule, so that no step waits for a sum over the picture. The momentum continues from frame to frame: p starts
from the previous change, and y keeps its distance to p. After a cut, both restart.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.files.tables import Table

STARTS = ("previous", "previous-direct", "map", "direct", "grey")
DEFAULT_STEPS, STEPS_WITHOUT_MAP = 4, 8
STEPS_OF_A_STILL = 128  # stills have time; 64 steps lose 0.7 dB with coarse unfocused cameras
GOOD_ENOUGH_DB = 0.1  # a picture this far below the optimum shows no difference
CLEAN_DB = 1.0  # a picture this far below the best measured value differs so little that it is hard to see
MOST_OFFERED = 16  # largest number of steps offered in a window
GREY = 0.5
OVER_RELAXATION = 0.6
LARGEST_MOMENTUM = 0.95  # below 1, so that every mode of an unclamped iteration decays for any number of steps

MOST_STEPS = 256
FINEST_DB, WORST_DB = 1e-3, 1e3  # limits of dB values in a manifest
SHARE_OF_FRAME = 0.8
LEAST_PATIENCE, PATIENCE = 8, 100  # first and longest wait after a late frame, in frames


def default_steps(start: str) -> int:
    """Return the default steps per frame; starts without T⁺ b get more steps."""
    return DEFAULT_STEPS if start in ("previous", "map") else STEPS_WITHOUT_MAP


@dataclass(frozen=True)
class Advice:
    """The maps' advice on playing a room: one of STARTS, and a number of steps per frame.

    curves : by start, dB below the optimum by number of steps, as measured by the build.
    """

    start: str
    steps: int
    curves: Mapping[str, "Curve"] = field(default_factory=dict)


@dataclass(frozen=True)
class Curve:
    """Curve of dB below the optimum by steps. Power laws in steps + 1 connect and extend the measured points."""

    steps: tuple[int, ...]
    decibels: tuple[float, ...]

    def at(self, steps: int) -> float:
        x, y = np.log1p(self.steps), np.log(np.maximum(self.decibels, FINEST_DB))
        if steps <= self.steps[-1]:
            return float(np.exp(np.interp(np.log1p(steps), x, y)))
        fall = min((y[-1] - y[-2]) / (x[-1] - x[-2]), 0.0)
        return float(np.exp(y[-1] + fall * (np.log1p(steps) - x[-1])))

    def least(self, decibels: float) -> int:
        """Return the fewest steps that end within `decibels`, at most MOST_STEPS."""
        return next((steps for steps in range(MOST_STEPS) if self.at(steps) <= decibels), MOST_STEPS)

    @property
    def clean_steps(self) -> int:
        """The fewest steps that end within CLEAN_DB of the best measured value."""
        return self.least(min(self.decibels) + CLEAN_DB)


@dataclass(frozen=True)
class Offer:
    """A start of refinement that may be chosen: its cost in steps, and the error curve of the steps after it."""

    start: str
    in_steps: float
    curve: Curve


def advice_of(details: Mapping[str, Any], where: str, fix: str) -> Advice | None:
    """Read the advice in the manifest of maps; None if it has none. Raises InputError for invalid values."""
    if "play" not in details:
        return None
    table = Table(details, where, fix).table("play")
    measured = table.table("below_optimum_db", optional=True)
    curves = _curves(measured) if measured.values else {}
    return Advice(table.choice("start", STARTS), table.integer("steps", None, 0, MOST_STEPS), curves)


def _curves(table: Table) -> dict[str, Curve]:
    counts = table.raw("steps", None)
    many = len(counts) if isinstance(counts, list) else 0
    steps = table.numbers("steps", max(many, 2), None, 0, MOST_STEPS)
    if np.any(np.diff(steps) <= 0):
        raise table.wrong("steps", "rising numbers of steps")
    named = [name for name in STARTS if name in table]
    return {
        name: Curve(tuple(map(int, steps)), tuple(table.numbers(name, steps.size, None, 0, WORST_DB))) for name in named
    }


def momentum(step: int) -> float:
    """Return β after step 1, 2, …"""
    return min(step / (step + 1), LARGEST_MOMENTUM)


@dataclass(frozen=True)
class Certificate:
    """Bound on the distance of a drive from the least Σ (T p − b)², 0 ≤ p ≤ 1, per colour channel.

    squared_error : (3,). E = ‖T p − b‖². In the player, over the lit camera pixels, with unlimited b.
    gap : (3,). G = Σ max(g p, g (p − 1)), with g the gradient of E/2. No drive lowers E/2 by more than G.
    outside : drive of projector pixels that the camera does not see, relative to the same sum of the uncompensated
        picture; None if the uncompensated picture's sum is 0 or was not measured.
    """

    squared_error: NDArray[np.float64]
    gap: NDArray[np.float64]
    outside: float | None = None

    def __repr__(self) -> str:
        return f"<Certificate: {self}>"

    @property
    def relative(self) -> float:
        """G / (E/2), with G and E summed over the channels."""
        return float(2 * self.gap.sum() / max(self.squared_error.sum(), 1e-300))

    @property
    def decibels(self) -> float:
        """Upper bound on the distance in dB from the optimum's PSNR; infinite if G gives no bound.

        The residual is a point of the dual problem; scaling it by its best factor turns G into E* ≥ (E − G)²/E.
        """
        E, G = self.squared_error, self.gap
        least = np.sum(np.maximum(E - G, 0) ** 2 / np.maximum(E, 1e-300))
        return float(10 * np.log10(max(E.sum(), 1e-300) / least)) if least > 0 else float("inf")

    def to_dict(self) -> dict[str, float | None]:
        """Return values for JSON; an infinite bound becomes None."""
        bound = self.decibels if np.isfinite(self.decibels) else None
        return {"relative_gap": self.relative, "certified_db": bound, "light_outside": self.outside}

    def __str__(self) -> str:
        bound = f"at most {self.decibels:.2g} dB below the optimum" if np.isfinite(self.decibels) else "no bound yet"
        return f"certified: {bound}, relative gap {self.relative:.2g}"


class StepBudget:
    """Chooses the steps that fit in the available time.

    interval_s : seconds per frame, or the allowed time.
    most : largest number of steps, at which the count begins; without `most`, the count begins at 1.
    least : smallest number of steps, regardless of time.

    The count grows by a quarter while frames end early. A frame that uses SHARE_OF_FRAME still ends in time with a
    quarter more steps. After a late frame, the count that would have fitted is kept for LEAST_PATIENCE frames, since
    other load on the machine may pass. Each failed try doubles this wait, up to PATIENCE frames.
    """

    def __init__(self, interval_s: float, most: int | None = None, least: int = 0) -> None:
        self.interval_s, self.least = interval_s, least
        self._wait, self._patience, self._tries = 0, LEAST_PATIENCE, False
        self.most = MOST_STEPS if most is None else most
        self.steps = max(least, 1) if most is None else most

    def follow(self, before: "StepBudget") -> None:
        """Continue from another budget, if it has the same time."""
        if before.interval_s == self.interval_s:
            self.steps = max(min(before.steps, self.most), self.least)
            self._wait, self._patience = before._wait, before._patience

    @property
    def _goal_s(self) -> float:
        return SHARE_OF_FRAME * self.interval_s

    def took(self, seconds: float) -> None:
        """Report the seconds that the last frame took with `steps` steps."""
        tried, self._tries = self._tries, False
        if not self.fits(seconds):
            fewer = min(int(self.steps * self._goal_s / seconds), self.steps - 1)
            self.steps = max(fewer, min(self.least, self.steps))
            self._wait, self._patience = self._patience, min(2 * self._patience, PATIENCE)
            return
        if tried:
            self._patience = LEAST_PATIENCE
        if self._wait:
            self._wait -= 1
        else:
            more = min(self.steps + max(self.steps // 4, 1), self.most)
            self.steps, self._tries = more, more > self.steps

    def fits(self, seconds: float) -> bool:
        """Whether a frame of this duration ends early enough."""
        return seconds <= self._goal_s

    def measured(self, base_s: float, step_s: float) -> None:
        """Report the measured time of a frame without steps, and of one step; the count then needs no trial."""
        fitting = self.fitting(base_s, step_s)
        # If twice as many steps fit, something else than the steps caused the delay.
        if fitting < self.steps or fitting >= 2 * self.steps or not self._wait:
            self.steps = min(max(fitting, self.least), self.most)

    def fitting(self, base_s: float, step_s: float) -> int:
        """Return the steps that fit into a frame."""
        return min(max(int((self._goal_s - base_s) / max(step_s, 1e-9)), 0), MOST_STEPS)
