"""The white level that a room can reach, and the adaptation of a frame to the room.

Adaptation (thesis 2.3: Ashdown et al. 2006, Grundhöfer and Bimber 2008) is global. For a picture u in shares of the
white level w, the target becomes w (s u + o), with one offset o ≥ 0 and one scale s ≤ 1 − o per frame. White therefore
never needs more light than before. Let b be the target without the ambient light e, and F b = U M' D' b the far light
of the compensated picture (room_maps.py). Near light must provide the rest. A single camera pixel can get from 0 to S·1
of near light, so the clipped light is

    n = w s (u − F u) + w o (1 − F 1) − (e − F e),        C(s, o) = Σ [n − S·1]₊ + [−n]₊

over the lit pixels inside the mask and the channels. C may be at most x percent of the total A = Σ max(w u, e). The
search first finds the smallest o with Σ [−n]₊ within half of this budget at s = 1 − o. It then finds the largest s with
C within the budget, or else the s with the smallest C. Both sums are convex in the searched variable, so linear
interpolation between two candidates never exceeds the budget. The sums ignore that pixels share near light. From frame
to frame, s and o approach the found values with a time constant of SMOOTHING_S. They restart at a cut.
"""

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.media.frames import Frame

REACHABLE_SHARE = 0.9  # share of the counted camera pixels that must reach the white level
# a pixel darker than FRACTION_OF_BRIGHT times this percentile counts as dark paint
BRIGHT_PERCENTILE, FRACTION_OF_BRIGHT = 99.0, 0.05
QUIETEST = 1e-30  # a mean squared error below this counts as 0
# CUT: mean change of the code values, in full scale; THUMBNAIL: samples along the shorter side
CUT, THUMBNAIL = 0.1, 48

SMOOTHING_S = 0.5


class SceneCuts:
    """Finds cuts (frames that are unrelated to the previous frame) from luma, or from red if there is no luma."""

    def __init__(self) -> None:
        self._last: NDArray[np.float32] | None = None

    def starts_with(self, frame: Frame) -> bool:
        """Returns True for the first frame, and if the subsampled luma changes by more than CUT on average."""
        pixels, plane = frame.format, frame.planes[0]
        every = max(1, min(pixels.height, pixels.width) // THUMBNAIL)
        samples = plane[: pixels.height : every, : pixels.width : every].astype(np.float32)
        last, self._last = self._last, samples
        if last is None:
            return True
        full = (1 << pixels.depth) - 1 if pixels.layout != "radiance" else max(last.max(), samples.max())
        return bool(np.mean(np.abs(samples - last)) > CUT * full)


class Succession:
    """Tracks which earlier frame a frame continues, independently of how often the frame is drawn.

    lasting : whether a frame may continue an older frame if the previous frame was not drawn.
    fresh : whether the frame restarts.
    elapsed_s : seconds since the frame that it continues.
    """

    def __init__(self, *, lasting: bool) -> None:
        self._lasting, self._drawn = lasting, False
        self.fresh, self.elapsed_s = True, 0.0

    def advance(self, *, cut: bool, duration_s: float = 0.0) -> bool:
        """Begin a new frame; returns True if the new frame continues from the previous frame's result."""
        drawn, self._drawn = self._drawn, False
        stays = drawn or (self._lasting and not self.fresh)
        self.fresh = cut or not stays
        self.elapsed_s = duration_s + (0.0 if drawn else self.elapsed_s)
        return drawn

    def draw(self) -> None:
        """Note that the frame has left a result for the next frame."""
        self._drawn = True

    def restart(self) -> None:
        """Restart with the current frame, without any earlier result."""
        self.fresh = True


def reachable_white(floodlight: NDArray[np.floating], mask: NDArray[np.bool_]) -> float:
    """Return the radiance that 90 % of the pixels inside the mask reach in all three channels; dark paint is left out.

    floodlight : (camera height, camera width, 3). T·1 + e.
    mask : (camera height, camera width), bool.

    All channels share one level, so that grey stays grey for the camera. Raises InputError for an empty mask.
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
    desired: NDArray[np.floating], seen: NDArray[np.floating], lit: NDArray[np.bool_], white: float
) -> float:
    """Return the peak signal-to-noise ratio of linear camera radiance over the lit pixels, in dB; the peak is `white`.

    desired, seen : (camera height, camera width, 3). PSNR = 10 log₁₀(white² / mean (seen − desired)²).
    """
    difference = (np.asarray(seen, np.float64) - desired)[lit] / white
    return psnr(float(np.mean(difference**2)))


def psnr(mean_square: float) -> float:
    """Return 10 log₁₀(1 / mean_square) in dB, for errors relative to white."""
    return float(-10 * np.log10(max(mean_square, QUIETEST)))


def approach(duration_s: float) -> float:
    """Return the share of the remaining difference by which the adaptation changes in a frame of this duration."""
    return float(1 - np.exp(-max(duration_s, 0.0) / SMOOTHING_S))
