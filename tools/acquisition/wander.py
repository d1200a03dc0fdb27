"""Find the gain of each capture where a camera's brightness wanders, as with an automatic white balance.

A capture of drive p is g (T p + e), with a gain g per channel. The first captures of white show how far gains
spread. From LEAST on, captures are divided by their gains, for which there is evidence of two kinds:

border : camera pixels that white lights little see g e + a F, where a picture of one colour shows a share of the
    floodlight F. The other camera pixels give a. A border with noise counts less: g is shrunk towards 1.
closure : the captures of a scheme's level add up to floodlit rooms in every camera pixel, Σ_k (h_k c_k − e) = cover T·1
    with h = 1 / g. Least squares over bright pixels fit h, with h = 1 as a prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.tools.acquisition.plan import Captures, LazyPatterns, Reference, mean_of, measure_noise

LEAST = 0.005  # least spread that counts; lamps and exposures that are steady stay below it
REPORTED = 0.01  # spread from which on the report says so
DIM = 2.0  # the floodlight may light the border with up to this multiple of the room's light
SURELY = 4  # a measured variance counts if it exceeds the noise by this number of standard deviations
FEWEST = 50  # least number of camera pixels of a border
WELL_LIT = 20  # light of a well-lit pixel, in multiples of the noise of a dark capture
MOST_PIXELS, MOST_CAPTURES = 1 << 12, 1 << 11  # largest numbers of pixels and captures in the least squares of a level
# share of the floodlight by which a level's sum may be too dark, because its faintest light is not shown again
UNCLOSED = 0.002
SURE = 1e-4  # least deviation that remains in a steadied capture


@dataclass(frozen=True)
class Wander:
    """The wandering gain of a camera.

    spread : (3,). Standard deviation of a capture's gain; 0 if all channels are below LEAST.
    border : (camera pixels,). Camera pixels that white lights little; none for a steady camera.
    room : black and white, without the wander.
    """

    spread: FloatArray
    border: BoolArray
    room: Reference

    def __str__(self) -> str:
        unseen = "" if self.border.any() else ", but not out of its colours, because no border of the view stays dark"
        return (
            f"the gain of captures wanders by {100 * float(self.spread.max()):.1f} %, which is taken out of T{unseen}; "
            "lock exposure, gain and white balance"
        )

    @property
    def is_active(self) -> bool:
        """Whether the gain wanders."""
        return bool(self.spread.any())

    @property
    def is_worth_a_line(self) -> bool:
        return bool(self.spread.max() > REPORTED)

    def steadied(self, captures: Captures | Sequence[NDArray[np.floating]]) -> LazyPatterns[FloatArray]:
        """Returns captures of pictures of one colour, divided by the gains that their border gives."""
        return LazyPatterns(len(captures), partial(self._steady, captures))

    def closed(self, captures: Captures, cover: int) -> Captures:
        """Returns a level's captures divided by gains with which they add up to `cover` floodlit rooms."""
        if not (self.is_active and cover and 1 < len(captures) <= MOST_CAPTURES):
            return captures
        pixels, room = self._bright, self.room
        seen = np.stack([captures[index].reshape(-1, 3)[pixels] for index in range(len(captures))]).astype(np.float64)
        light, dark = room.light[pixels], room.black.reshape(-1, 3)[pixels]
        missing = cover * light + len(captures) * dark - seen.sum(axis=0)
        noise = room.noise.averaged(captures.repeats)
        variance = len(captures) * noise.dark**2 + noise.gain * light + (UNCLOSED * light) ** 2
        prior, gains = captures.repeats / np.maximum(self.spread, SURE) ** 2, np.ones((len(captures), 3))
        for i in range(3):
            A, weighted = seen[:, :, i], seen[:, :, i] / variance[:, i]
            rest = np.linalg.solve(weighted @ A.T + prior[i] * np.eye(len(A)), weighted @ missing[:, i])
            gains[:, i] = 1 / (1 + rest)
        return Divided(captures, gains)

    @property
    def left(self) -> FloatArray:
        """Standard deviation of the gain that remains in a steadied capture, (3,)."""
        return np.asarray(self.spread * np.sqrt(1 - self._border.trust)) if self.border.any() else self.spread

    def gain(self, capture: NDArray[np.floating]) -> FloatArray:
        """Returns the gain of a capture (camera height, camera width, 3): (3,)."""
        light, seen, border = self.room.light, capture.reshape(-1, 3), self._border
        share = np.sum(border.lit * self.room.above_black(capture), axis=0)
        found = np.sum(border.weights * (seen - share * light)[self.border], axis=0)
        return np.asarray(1 + (found - 1) * border.trust)

    def _steady(self, captures: Captures | Sequence[NDArray[np.floating]], index: int) -> FloatArray:
        seen = captures[index].astype(np.float64)
        return np.asarray(seen / self.gain(seen)) if self.border.any() else seen

    @property
    def _bright(self) -> IntArray:
        """Camera pixels that are well lit in all channels, at most MOST_PIXELS."""
        lit = np.all(self.room.light > WELL_LIT * self.room.noise.dark, axis=1) & ~self.room.saturated.ravel()
        found = np.flatnonzero(lit)
        return found[:: max(1, -(-found.size // MOST_PIXELS))]

    @cached_property
    def _border(self) -> "_Border":
        room, tiny = self.room, np.finfo(float).tiny
        lit = _share_of_white(room, self.border)
        dark, variance = room.black.reshape(-1, 3)[self.border], room.noise.sigma(room.light[self.border]) ** 2
        weights = dark / np.maximum(variance, tiny)
        whole = np.maximum(np.sum(weights * dark, axis=0), tiny)
        return _Border(lit, weights / whole, self.spread**2 / np.maximum(self.spread**2 + 1 / whole, tiny))


def steadied_by_border(
    room: Reference, captures: Sequence[NDArray[np.floating]]
) -> tuple[Wander, Sequence[NDArray[np.floating]]]:
    """Returns the wander of a camera that captures each picture once, and the captures without their gains.

    The gain g comes from the border. Its light is g (a + b s), with s the share of white that other pixels see. Least
    squares over the captures fit a and b, so that the mean gain is 1.
    """
    border, steady = _border_of(room), Wander(np.zeros(3), np.zeros(room.light.shape[0], np.bool_), room)
    if np.count_nonzero(border) < FEWEST:
        return steady, captures
    lit = _share_of_white(room, border)
    shares = np.stack([np.sum(lit * room.above_black(each), axis=0) for each in captures])
    seen = np.stack([each.reshape(-1, 3)[border].astype(np.float64) for each in captures])
    usual = seen.mean(axis=0)
    weights = usual / np.maximum(room.noise.sigma(usual) ** 2, np.finfo(float).tiny)
    noise = 1 / np.sum(usual * weights, axis=0)
    found = np.sum(seen * weights, axis=1) * noise
    for k in range(3):
        A = np.stack([np.ones(len(found)), shares[:, k]], axis=1)
        found[:, k] /= A @ np.linalg.lstsq(A, found[:, k])[0]
    variance = found.var(axis=0, ddof=2)
    spread = np.where(variance > noise * (1 + SURELY * np.sqrt(2 / len(found))), np.sqrt(variance), 0)
    if spread.max() < LEAST:
        return steady, captures
    gains = 1 + (found - 1) * spread**2 / (spread**2 + noise)
    divided = LazyPatterns(len(captures), lambda index: np.asarray(captures[index] / gains[index]))
    return Wander(spread, border, room), divided


def _share_of_white(room: Reference, border: BoolArray) -> FloatArray:
    """Returns factors (camera pixels, 3) whose sum with light outside the border is the share of white in it."""
    lit = np.where(border[:, None] | room.saturated.reshape(-1, 1), 0, room.light)
    return np.asarray(lit / np.maximum(np.sum(lit**2, axis=0), np.finfo(float).tiny))


def _border_of(room: Reference) -> BoolArray:
    """Returns camera pixels that white lights little, (camera pixels,)."""
    dim = np.all(room.light < DIM * room.black.reshape(-1, 3), axis=1)
    return np.asarray(dim & ~room.saturated.ravel())


@dataclass(frozen=True)
class _Border:
    """Estimates of a and g from a border.

    lit : (camera pixels, 3). Weights of light above black, whose sum is the share of the floodlight.
    weights : (border pixels, 3). Weights of the border's light, whose sum is the gain.
    trust : (3,). Share of the gain's deviation from 1 that is no noise.
    """

    lit: FloatArray
    weights: FloatArray
    trust: FloatArray


class Divided:
    """Captures divided by gains, (captures, 3)."""

    def __init__(self, captures: Captures, gains: FloatArray) -> None:
        self._captures, self._gains = captures, gains.astype(np.float32)

    @property
    def repeats(self) -> int:
        return self._captures.repeats

    def __len__(self) -> int:
        return len(self._captures)

    def __getitem__(self, index: int) -> NDArray[np.floating]:
        return np.asarray(self._captures[index] / self._gains[index])


def wander_of(room: Reference, black: Sequence[FloatArray], white: Sequence[FloatArray]) -> Wander:
    """Returns the wander of a camera, from its captures of black and of the floodlit room."""
    light, used = room.light, ~room.saturated.ravel()
    whole = np.maximum(np.sum(light[used] ** 2, axis=0), np.finfo(float).tiny)
    gains = np.stack([np.sum(light[used] * room.above_black(each)[used], axis=0) / whole for each in white])
    by_noise = np.sum(light[used] ** 2 * room.noise.dark**2, axis=0) / whole**2
    spread = np.sqrt(np.maximum(gains.var(axis=0, ddof=1) - by_noise, 0))
    border = _border_of(room)
    if spread.max() < LEAST:
        return Wander(np.zeros(3), np.zeros_like(border), room)
    alike = [each / gain for each, gain in zip(white, np.maximum(gains, LEAST), strict=True)]
    room = replace(room, noise=measure_noise(black, alike))
    if np.count_nonzero(border) < FEWEST:
        return Wander(spread, np.zeros_like(border), room)
    steadied = Wander(spread, border, room).steadied(white)
    return Wander(spread, border, replace(room, floodlight=mean_of(steadied)))
