"""What a picture asks of a room: the white level that the room can reach; and what the next frame has to do with it."""

import numpy as np
from numpy.typing import NDArray

from player.errors import InputError
from player.frames import Frame

REACHABLE_SHARE = 0.9  # of the camera pixels that count
CUT, THUMBNAIL = 0.1, 48  # mean change of the code values, in full scale; samples along the shorter side


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


def reachable_white(floodlight: NDArray[np.floating], mask: NDArray[np.bool_]) -> float:
    """The radiance that nine in ten of the pixels inside the mask reach in all three channels.

    floodlight : (camera height, camera width, 3), T·1 + e.  mask : (camera height, camera width).
    One level for all channels, so that grey stays grey in the camera's eyes.
    """
    weakest = floodlight.min(axis=2)[mask]
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
    difference = (np.asarray(seen, np.float64) - desired)[mask]
    return float(10 * np.log10(white**2 / max(float(np.mean(difference**2)), 1e-30)))
