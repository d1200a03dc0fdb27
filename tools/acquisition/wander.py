"""Find the gain of each capture where a camera's brightness wanders, as with an automatic white balance.

A capture of drive p is g (T p + e), with a gain g per channel. The captures of white at the beginning tell how far
gains spread. From LEAST on, captures are divided by the gains that the border tells: the camera pixels that white does
not light see g e. A border with noise counts less: g is the mean of 1 and of the border's gain, weighted by variances.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray
from counterlight.tools.acquisition.plan import LazyPatterns, Reference, mean_of

LEAST = 0.005  # spread; lamps and exposures that are steady stay below it
REPORTED = 0.01  # spread from which on the report says so
UNLIT = 3.0  # multiple of the noise of the floodlight up to which a camera pixel belongs to the border
FEWEST = 50  # camera pixels of a border


@dataclass(frozen=True)
class Wander:
    """The wandering gain of a camera.

    spread : (3,). Standard deviation of a capture's gain; 0 for a steady camera.
    border : (camera pixels,). Camera pixels that white does not light; none for a steady camera.
    room : black and white.
    """

    spread: FloatArray
    border: BoolArray
    room: Reference

    def __str__(self) -> str:
        undone = (
            "divided out" if self.border.any() else "averaged, for want of a border that the projector does not light"
        )
        return (
            f"the gain of captures wanders by {100 * float(self.spread.max()):.1f} %, {undone}; lock what is automatic"
        )

    @property
    def is_worth_a_line(self) -> bool:
        return bool(self.spread.max() > REPORTED)

    def steadied(self, captures: Sequence[NDArray[np.floating]]) -> LazyPatterns[FloatArray]:
        """Returns captures divided by the gains that their border tells."""
        return LazyPatterns(len(captures), partial(self._steady, captures))

    def _steady(self, captures: Sequence[NDArray[np.floating]], index: int) -> FloatArray:
        seen = captures[index].astype(np.float64)
        return np.asarray(seen / self.gain(seen)) if self.border.any() else seen

    @property
    def left(self) -> FloatArray:
        """Standard deviation of the gain that remains in a steadied capture, (3,)."""
        if not self.border.any():
            return self.spread
        return np.asarray(self.spread * np.sqrt(1 - self._trust))

    def gain(self, capture: NDArray[np.floating]) -> FloatArray:
        """Returns the gain of a capture (camera height, camera width, 3): (3,)."""
        found = capture.reshape(-1, 3)[self.border].sum(axis=0, dtype=np.float64) / self._dark
        return np.asarray(1 + (found - 1) * self._trust)

    @property
    def _dark(self) -> FloatArray:
        """Light of the border without the projector, (3,)."""
        whole = self.room.black.reshape(-1, 3)[self.border].sum(axis=0)
        return np.asarray(np.maximum(whole, np.finfo(float).tiny))

    @property
    def _trust(self) -> FloatArray:
        """Share of the border's deviation from 1 that is not noise, (3,)."""
        by_noise = np.count_nonzero(self.border) * self.room.noise.dark**2 / self._dark**2
        return np.asarray(self.spread**2 / (self.spread**2 + by_noise))


def wander_of(room: Reference, white: Sequence[NDArray[np.floating]]) -> Wander:
    """Returns the wander of a camera; white is its captures of the floodlit room."""
    light, used = room.light, ~room.saturated.ravel()
    whole = np.maximum(np.sum(light[used] ** 2, axis=0), np.finfo(float).tiny)
    gains = np.stack([np.sum(light[used] * room.above_black(each)[used], axis=0) / whole for each in white])
    by_noise = np.sum(light[used] ** 2 * room.noise.sigma(light[used]) ** 2, axis=0) / whole**2
    spread = np.sqrt(np.maximum(gains.var(axis=0, ddof=1) - by_noise, 0))
    border = used & np.all(light < UNLIT * room.rise_noise, axis=1)
    if spread.max() < LEAST or np.count_nonzero(border) < FEWEST:
        return Wander(spread, np.zeros_like(border), room)
    steadied = Wander(spread, border, room).steadied(white)
    return Wander(spread, border, replace(room, floodlight=mean_of(steadied)))
