"""Test a room of few pictures: predict the last random pictures with a fit that did not use them.

A second fit uses half as many pictures. Its loss estimates how much twice as many pictures would gain.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.acquisition.check import Check
from counterlight.tools.acquisition.few.fitting import Fit, fitted, sampled
from counterlight.tools.acquisition.few.order import RAMPS
from counterlight.tools.acquisition.few.places import Spots
from counterlight.tools.acquisition.few.seen import Seen, Table, some
from counterlight.tools.acquisition.linearity import Bend, bend_of_shares

HELD = 8  # one random picture in HELD is held out
RAMPS_ALONE = "held out: nothing, since there is no random picture; the check is of the ramps, and blind to sharpness"


@dataclass(frozen=True)
class Held:
    """The result of the test.

    check : the fit by `pictures` random pictures, tested on the `held` others.
    half : the fit by half as many pictures.
    """

    check: Check
    half: Check
    pictures: int
    held: int

    def __str__(self) -> str:
        out = f"{self.held} random picture{'s' if self.held > 1 else ''}"
        said = f"held out: {out}, predicted to {100 * self.check.error:.1f} % by {self.pictures} others"
        if self.pictures < 2:
            return f"{said}; more pictures would tell the shapes of spots, and far light"
        gained = min(self.check.excess / max(self.half.excess, 1e-9), 1.0)
        next_error = min(float(np.hypot(gained * self.check.excess, self.check.noise)), self.check.error)
        return (
            f"{said}, to {100 * self.half.error:.1f} % by {self.pictures // 2}; twice as many would give about "
            f"{100 * next_error:.1f} % (noise alone: {100 * self.check.noise:.1f} %)"
        )


def held_out(seen: Seen, table: Table, spots: Spots, random: Sequence[int]) -> Held | None:
    """Run the test; None without random pictures. `table` is the projector's light per code value."""
    if not random:
        return None
    held = max(1, len(random) // HELD)
    others, out = random[:-held], random[-held:]
    fit = fitted(seen, table, spots, others)
    check = replace(_check(fit, out), lights=_lights(fit, out))
    half = _check(fitted(seen, table, spots, others[: len(others) // 2]), out) if len(others) > 1 else check
    return Held(check, half, len(others), held)


def bend_by(fit: Fit, pictures: Sequence[int]) -> Bend | None:
    """Test whether the camera is linear, with random pictures; None if there are none."""
    if not pictures:
        return None
    chosen = sampled(fit.windows)
    pixels = fit.windows.pixel[chosen]
    predicted, captured = fit.predicted(chosen, pictures), fit.seen.captured(pixels, pictures)
    white = np.broadcast_to(np.maximum(fit.primaries[pixels].sum(axis=2), 0)[:, None], captured.shape)
    shares = np.divide(predicted, white, out=np.zeros_like(predicted), where=white > 0)
    return bend_of_shares(captured, shares, white, fit.seen.room.noise.dark)


def check_ramps(fit: Fit) -> Check:
    """Check the prediction of the ramps, which reveals little about sharpness."""
    return _check(fit, [RAMPS], "the ramps of the acquisition")


def _lights(fit: Fit, pictures: Sequence[int]) -> FloatArray:
    """Returns predicted and captured light above black, (2, pictures, camera pixels, 3); no place predicts 0."""
    windows = fit.windows
    captured = fit.seen.above[np.asarray(pictures)].astype(np.float64)
    predicted, every = np.zeros_like(captured), np.arange(len(windows.pixel))
    for part in some(every, 8 * len(pictures) * windows.size):
        predicted[:, windows.pixel[part]] = fit.predicted(every[part], pictures).transpose(1, 0, 2)
    return np.stack([predicted, captured])


def _check(fit: Fit, pictures: Sequence[int], of: str = Check.of) -> Check:
    """Check the prediction of pictures at camera pixels that have a place."""
    chosen = sampled(fit.windows)
    captured = fit.seen.captured(fit.windows.pixel[chosen], pictures)
    off = float(np.sum((fit.predicted(chosen, pictures) - captured) ** 2))
    scale = max(float(np.sum(captured**2)), np.finfo(float).tiny)
    of_black = captured.size / 3 * float(np.sum(fit.seen.room.noise.dark**2))
    noise = float(np.sum(fit.seen.room.noise.sigma(captured) ** 2)) + of_black
    return Check(float(np.sqrt(off / scale)), float(np.sqrt(noise / scale)), of)
