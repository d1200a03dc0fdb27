"""What a picture asks of a room: the white level that it can reach, the adaptation of a frame to the room.

Adaptation (thesis 2.3: Ashdown et al. 2006, Grundhöfer and Bimber 2008) is global: of a picture u in shares of the
white level w the room is asked for w (s u + o) instead, one offset o ≥ 0 and one scale s ≤ 1 − o for a frame, so that
white never asks for more than it did. Of the light b that is asked for beside the ambient light e, the far light of the
compensated picture is F b = U M' D' b (room_maps.py), and the near light has to give the rest. A camera pixel alone
can have from 0 to S·1 of that, so that

    n = w s (u − F u) + w o (1 − F 1) − (e − F e),        C(s, o) = Σ [n − S·1]₊ + [−n]₊

over the lit pixels inside the mask and the channels is the light that clips, to be at most x percent of
A = Σ max(w u, e). First the least o with Σ [−n]₊ within half of that at s = 1 − o, then the largest s with C within
all of it; where there is none, the s with the least C. Both sums are convex in what is searched, so that a line between
two candidates never promises too much; that pixels share near light is not known to the sums. From frame to frame s
and o approach what was found with a time constant of SMOOTHING_S, and start anew at a cut.
"""

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.media.frames import Frame

REACHABLE_SHARE = 0.9  # of the camera pixels that count
BRIGHT_PERCENTILE, FRACTION_OF_BRIGHT = 99.0, 0.05  # darker than that share of the bright pixels is dark paint
QUIETEST = 1e-30  # mean squared error that counts as none
CUT, THUMBNAIL = 0.1, 48  # mean change of the code values, in full scale; samples along the shorter side

SCALES = np.linspace(1, 0.25, 16)  # candidates of s / (1 − o), the preferred first
OFFSETS = 0.25 * np.linspace(0, 1, 16) ** 2  # of o, in shares of white
TILES, SAMPLES = 16, 16  # the camera's view is summed in 16 × 16 tiles of at most so many samples a side
SMOOTHING_S = 0.5


class SceneCuts:
    """Finds the frames that have little to do with the one before, by their luma (red, where there is none)."""

    def __init__(self) -> None:
        self._last: NDArray[np.float32] | None = None

    def starts_with(self, frame: Frame) -> bool:
        """True for the first frame, and if the thinned-out luma changes by more than CUT on average."""
        pixels, plane = frame.format, frame.planes[0]
        every = max(1, min(pixels.height, pixels.width) // THUMBNAIL)
        samples = plane[: pixels.height : every, : pixels.width : every].astype(np.float32)
        last, self._last = self._last, samples
        if last is None:
            return True
        full = (1 << pixels.depth) - 1 if pixels.layout != "radiance" else max(last.max(), samples.max())
        return bool(np.mean(np.abs(samples - last)) > CUT * full)


class Succession:
    """How a frame goes on from the one before, the same however often it is drawn.

    lasting : what a frame goes on from may be older than the frame before, if that was not drawn.
    fresh : it starts anew.  elapsed_s : since the frame that it goes on from.
    """

    def __init__(self, *, lasting: bool) -> None:
        self._lasting, self._drawn = lasting, False
        self.fresh, self.elapsed_s = True, 0.0

    def advance(self, *, cut: bool, duration_s: float = 0.0) -> bool:
        """A new frame comes; True if what the last one left becomes what this one goes on from."""
        drawn, self._drawn = self._drawn, False
        stays = drawn or (self._lasting and not self.fresh)
        self.fresh = cut or not stays
        self.elapsed_s = duration_s + (0.0 if drawn else self.elapsed_s)
        return drawn

    def draw(self) -> None:
        """The frame leaves something for the next one."""
        self._drawn = True

    def restart(self) -> None:
        """Whatever was left has nothing to do with this frame any more."""
        self.fresh = True


def reachable_white(floodlight: NDArray[np.floating], mask: NDArray[np.bool_]) -> float:
    """The radiance that nine in ten of the pixels inside the mask reach in all three channels, dark paint left out.

    floodlight : (camera height, camera width, 3), T·1 + e.  mask : (camera height, camera width).
    One level for all channels, so that grey stays grey in the camera's eyes.
    """
    inside = floodlight[mask]
    light = inside.sum(axis=1)
    bright = np.percentile(light, BRIGHT_PERCENTILE, method="lower") if light.size else 0.0
    weakest = inside.min(axis=1)[light >= FRACTION_OF_BRIGHT * bright]
    if weakest.size == 0:
        raise InputError("the mask is empty: no camera pixel counts; check mask.png")
    level = float(np.percentile(weakest, 100 * (1 - REACHABLE_SHARE)))
    if level <= 0:
        raise InputError(
            "a tenth of the camera pixels that count gets no light from the projector in some channel; "
            "draw a mask that leaves them out, or look for an empty channel"
        )
    return level


def camera_psnr(
    desired: NDArray[np.floating], seen: NDArray[np.floating], mask: NDArray[np.bool_], white: float
) -> float:
    """Peak signal-to-noise ratio of linear camera radiance inside the mask, in decibels; the peak is `white`.

    desired, seen : (camera height, camera width, 3).  PSNR = 10 log₁₀(white² / mean (seen − desired)²).
    """
    difference = (np.asarray(seen, np.float64) - desired)[mask] / white
    return psnr(float(np.mean(difference**2)))


def psnr(mean_square: float) -> float:
    """10 log₁₀(1 / mean square) in decibels, for errors relative to white."""
    return float(-10 * np.log10(max(mean_square, QUIETEST)))


def tile_grid(shape: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
    """(rows, columns) of the pixels of a tile, and of the steps from one sample to the next within it."""
    tile = -(-shape[0] // TILES), -(-shape[1] // TILES)
    return tile, (-(-tile[0] // SAMPLES), -(-tile[1] // SAMPLES))


def approach(duration_s: float) -> float:
    """How far towards what was found the adaptation goes in a frame of this duration."""
    return float(1 - np.exp(-max(duration_s, 0.0) / SMOOTHING_S))
