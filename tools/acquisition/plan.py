"""Types that schemes share: levels of patterns that request captures, black and floodlight of the room, and noise.

A scheme is a generator. It yields one level of patterns after the other, is sent the captures of that level, and
returns the light transport that it computed. It has no other input or state: the same captures lead to the same
patterns, which makes an acquisition resumable.
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.tools.transport.transport import Transport

Pattern: TypeAlias = NDArray[np.bool_]  # (projector height, projector width); lit or dark, whatever the response
Codes: TypeAlias = NDArray[np.uint8]  # (projector height, projector width, 3); code values sent to the projector
Picture: TypeAlias = Pattern | Codes  # a picture of a level
Painted = TypeVar("Painted", covariant=True)
REPEATS = 16  # captures of black, floodlight and primaries; 16 gain 5 dB over 4 on a smooth wall, for 24 more pictures
MAD_TO_SIGMA = 1.4826  # factor from the median absolute deviation to σ, for a normal distribution


@dataclass(frozen=True)
class Noise:
    """A camera's noise, variance = dark² + gain · light, per channel.

    dark : (3,). Standard deviation of a black picture, radiance.
    gain : (3,). Photon noise, radiance.
    """

    dark: FloatArray
    gain: FloatArray

    def sigma(self, light: NDArray[np.floating]) -> FloatArray:
        """Returns the standard deviation of one capture of `light` (…, 3) above black."""
        return np.asarray(np.sqrt(self.dark**2 + self.gain * np.maximum(light, 0)))

    def averaged(self, captures: int) -> "Noise":
        """Returns the noise of the mean of `captures` captures."""
        return Noise(self.dark / np.sqrt(captures), self.gain / captures)


@dataclass(frozen=True)
class Reference:
    """The room before any scheme; all captures are compared with it.

    black, floodlight : (camera height, camera width, 3). Radiance with the projector black, and white.
    noise : noise of a capture.
    saturated : (camera height, camera width) bool. Pixels at the top of the camera's range in white or black.
    repeats : number of captures that black and floodlight average.
    """

    black: FloatArray
    floodlight: FloatArray
    noise: Noise
    saturated: NDArray[np.bool_]
    repeats: float = 1

    @property
    def light(self) -> FloatArray:
        """T·1 as measured, (camera pixels, 3)."""
        return (self.floodlight - self.black).reshape(-1, 3)

    @property
    def rise_noise(self) -> FloatArray:
        """Standard deviation of `light` where it is faint, (3,); `light` is the difference of two means."""
        return np.asarray(self.noise.dark * np.sqrt(2 / self.repeats))

    def above_black(self, capture: NDArray[np.floating]) -> FloatArray:
        """Returns T p of a capture (camera height, camera width, 3): (camera pixels, 3)."""
        return (capture - self.black).reshape(-1, 3)

    def averaged(self, captures: int) -> "Reference":
        """Returns the same room, where the mean of `captures` captures counts as one capture."""
        return replace(self, noise=self.noise.averaged(captures), repeats=self.repeats / captures)


@dataclass(frozen=True)
class Expected:
    """A level that may come.

    pictures : approximate number of pictures.
    share : captures relative to the finest pictures, where pictures are taken repeatedly; 0 means one capture.
    """

    pictures: int
    share: float = 0.0


@dataclass(frozen=True)
class Level:
    """A group of patterns whose choice does not depend on each other's captures.

    patterns : made lazily; a scheme's patterns are black and white.
    later : levels of the scheme that may still come.
    cover : how often the patterns together light each projector pixel that a camera pixel sees; 0 if unevenly. Their
        captures must add up to as many floodlit rooms.
    share : see Expected.
    """

    name: str
    patterns: Sequence[Picture]
    later: tuple[Expected, ...] = ()
    cover: int = 0
    share: float = 0.0

    @property
    def expected(self) -> Expected:
        """This level in the form that plans use."""
        return Expected(len(self.patterns), self.share)


class Captures(Protocol):
    """Radiance of a level's pictures, (camera height, camera width, 3) each, the mean of `repeats` captures."""

    @property
    def repeats(self) -> int: ...
    def __len__(self) -> int: ...
    def __getitem__(self, index: int) -> NDArray[np.floating]: ...


@dataclass(frozen=True)
class Measured:
    """The result of a scheme: T, and notes for the user, one line each."""

    transport: Transport
    notes: tuple[str, ...] = ()


Scheme: TypeAlias = Generator[Level, Captures, Measured]


class MakeScheme(Protocol):
    """Makes a scheme for a room and a projector of (height, width)."""

    def __call__(self, room: Reference, projector: tuple[int, int]) -> Scheme: ...
    def expected(self, projector: tuple[int, int]) -> tuple[Expected, ...]:
        """Returns the levels that may come, before anything is known of the room."""


class LazyPatterns(Sequence[Painted]):
    """Pictures made on access, because a whole level of them would not fit into memory."""

    def __init__(self, count: int, paint: Callable[[int], Painted]) -> None:
        self._count, self._paint = count, paint

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> Painted: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Painted]: ...
    def __getitem__(self, index: int | slice) -> Painted | Sequence[Painted]:
        if isinstance(index, slice):
            return [self._paint(i) for i in range(*index.indices(self._count))]
        if not 0 <= index < self._count:
            raise IndexError(index)
        return self._paint(index)

    def __iter__(self) -> Iterator[Painted]:
        return (self._paint(i) for i in range(self._count))


def codes_of(picture: Picture) -> Codes:
    """Returns a picture as code values: patterns become black and white, codes are returned unchanged."""
    if picture.ndim == 3:
        return picture.astype(np.uint8, copy=False)
    return np.repeat(picture[..., None].astype(np.uint8) * np.uint8(255), 3, axis=2)


def measure_noise(black: Sequence[FloatArray], floodlight: Sequence[FloatArray]) -> Noise:
    """Measure the noise from equally many captures of black and white, (camera height, camera width, 3) each.

    The difference of two equal captures has twice the variance. The dark level is a median, so that a flickering corner
    does not count. It is at least the rounding error of the camera's code values, 1/√12 of a step.
    """
    first = floodlight[0]
    steps = np.array([_least_step(first[..., i]) for i in range(3)])
    spread = np.array([[MAD_TO_SIGMA * np.median(np.abs(each)), np.std(each) / 2] for each in _changes(black)])
    dark = np.maximum(spread.max(axis=1), steps / np.sqrt(12))
    light = np.maximum(mean_of(floodlight) - mean_of(black), 0).mean(axis=(0, 1))
    excess = np.array([np.mean(each**2 - level**2) for each, level in zip(_changes(floodlight), dark, strict=True)])
    return Noise(dark, np.maximum(excess, 0) / np.maximum(light, np.finfo(float).tiny))


def mean_of(pictures: Sequence[FloatArray]) -> FloatArray:
    """Returns the mean of pictures, with one of them in memory at a time."""
    total = pictures[0]
    for number in range(1, len(pictures)):
        total = total + pictures[number]
    return np.asarray(total / len(pictures))


def _changes(pictures: Sequence[FloatArray]) -> FloatArray:
    """Returns the differences of successive captures / √2, which have the variance of one capture: (3, all pixels)."""
    pairs = len(pictures) // 2
    changes = np.empty((3, pairs, pictures[0][..., 0].size))
    for pair in range(pairs):
        changes[:, pair] = (pictures[2 * pair + 1] - pictures[2 * pair]).reshape(-1, 3).T / np.sqrt(2)
    return changes.reshape(3, -1)


def _least_step(values: FloatArray) -> float:
    gaps = np.diff(np.unique(values))
    return float(gaps.min()) if gaps.size else 0.0
