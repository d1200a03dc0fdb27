"""A few pictures that represent usual content, and a few squares of the camera picture that represent the whole.

λ is chosen by what the clamp does to the pictures. λ and the necessary steps are means over the picture, which would
take minutes; five squares are enough to find them (docs/size.md).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.calibration import Calibration
from counterlight.pipeline.fitting import on_cameras
from counterlight.tools.transport.transport import Csr

PICTURES = 3
SIDE, SMALLEST_SIDE = 96, 24
MOST_ENTRIES = 1 << 21  # entries of T in all squares
BORDER = 8  # outer pixels of a square, which represent its surroundings
CENTRES = ((0.5, 0.5), (0.25, 0.25), (0.25, 0.75), (0.75, 0.25), (0.75, 0.75))


def typical_pictures(shape: tuple[int, int]) -> list[FloatArray]:
    """Return three grey pictures (height, width), linear, 0..1: like a photograph, like lettering, and a bright ramp.

    The pictures depend on the shape only. The photograph is 1/f noise, because the amplitude of natural pictures falls
    as 1/f (Field 1987).
    """
    height, width = shape
    y, x = np.mgrid[:height, :width]
    ramp = (x + 0.5) / width
    stroke = max(2, width // 60)
    letters = ((x // stroke + 2 * (y // (3 * stroke))) % 5 < 2) & (y // (3 * stroke) % 2 == 0)
    return [noise_picture(shape, 1.0), np.where(letters, 0.9, 0.05), 0.2 + 0.75 * ramp]


def soft_picture(shape: tuple[int, int]) -> FloatArray:
    """Return a picture like a soft photograph, (height, width), linear, 0..1: 1/f² noise, softer than 1/f."""
    return noise_picture(shape, 2.0)


def pictures_of(calibration: Calibration) -> list[FloatArray]:
    """Return the typical pictures in the camera's view; for several cameras, from their shared screen."""
    grey = typical_pictures(calibration.placed_on)
    return [on_cameras(np.repeat(picture[..., None], 3, axis=2), calibration)[..., 0] for picture in grey]


def noise_picture(shape: tuple[int, int], slope: float, seed: int = 2006) -> FloatArray:
    """Return noise whose amplitude falls as 1/f^slope, (height, width), linear, 0..1."""
    height, width = shape
    frequency = np.hypot(np.fft.fftfreq(height)[:, None] * height, np.fft.rfftfreq(width)[None, :] * width)
    noise = np.fft.rfft2(np.random.default_rng(seed).standard_normal(shape))
    picture = np.fft.irfft2(noise / np.maximum(frequency, 1.0) ** slope, s=shape)
    low, high = np.percentile(picture, [2, 98])
    return np.asarray(
        np.clip((picture - low) / max(high - low, 1e-12), 0, 1) ** 2
    )  # squared: linear light is mostly dark


@dataclass(frozen=True)
class Squares:
    """Camera pixels of some squares, ascending.

    rows : (n,).
    inner : (n,) bool. Pixels away from a square's border.
    """

    rows: IntArray
    inner: BoolArray

    def compact(self, T: Csr, columns: IntArray) -> Csr:
        """Return T of the squares' camera pixels and the given projector pixels."""
        return Csr(T[self.rows][:, columns])

    def columns(self, T: Csr) -> IntArray:
        """Return the projector pixels that light the squares, ascending."""
        return np.unique(T[self.rows].indices).astype(np.int64)


def squares_of(mask: NDArray[np.bool_], entries: int) -> Squares:
    """Return squares of at most 96 pixels a side in the mask's bounding box, smaller if T is dense.

    mask : (camera height, camera width). Pixels that count.
    entries : entries of T in one channel.
    """
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    top, left, height, width = rows[0], columns[0], int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1
    density = entries / max(int(np.count_nonzero(mask)), 1)
    side = int(np.clip(np.sqrt(MOST_ENTRIES / (len(CENTRES) * max(density, 1))), SMALLEST_SIDE, SIDE))
    chosen, inner = np.zeros(mask.shape, bool), np.zeros(mask.shape, bool)
    for down, across in CENTRES:
        y, x = (
            int(start + share * max(extent - side, 0))
            for start, share, extent in ((top, down, height), (left, across, width))
        )
        chosen[y : y + side, x : x + side] = True
        inner[_inner(y, side, mask.shape[0]), _inner(x, side, mask.shape[1])] = True
    if not (chosen & mask).any():
        chosen, inner = np.ones_like(mask), np.ones_like(mask)
    found = np.flatnonzero((chosen & mask).ravel())
    within = inner.ravel()[found]
    return Squares(found, within if within.any() else np.ones_like(within))


def _inner(start: int, side: int, extent: int) -> slice:
    """Return the part along an axis without the border; there is no border at the picture's own edge."""
    return slice(start + BORDER if start > 0 else 0, start + side - BORDER if start + side < extent else extent)
