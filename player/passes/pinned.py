"""Places a picture by a projective map, with black around it.

The filter is a tent along each axis of the picture, as wide as a target pixel in the picture. Its half width is √(∂x² +
∂y²) of the map's derivatives, at least one pixel, so an upright placement matches resample.py. An edge pixel is
weighted by its covered part, estimated from the distance to the edge.
"""

from dataclasses import dataclass
from typing import Any, Generic

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.drawing import CHANNELS, NOTHING, Array, Numbers, Pass, Picture
from counterlight.passes.kernel import PICTURE, inlined, kernel, prange, projected, within

TINY = 1e-12  # smallest width to divide by, in pixels
MOST_TAPS = 32  # along an axis; a wider filter takes every second or third sample, and so on


@dataclass(frozen=True, eq=False)
class OnScreen(Generic[Picture]):
    """Screen positions of the target's pixels, with their slopes (counterlight.screen.axes)."""

    across: Picture
    down: Picture


@dataclass(frozen=True, eq=False)
class Pinned(Pass[Picture]):
    """The source on black.

    to_source : (9,). H, column by column: target (or screen) position -> source position, in pixels
        (counterlight.pipeline.placement.homography).
    screen : positions that the target's pixels see; None without a screen.
    """

    shader = "pinned.frag"
    defines = {"MOST_TAPS": MOST_TAPS}  # noqa: RUF012
    source: Picture
    to_source: Numbers
    screen: OnScreen[Picture] | None = None

    def fill(self: "Pinned[Array]", out: Array) -> None:
        H = np.ascontiguousarray(np.reshape(self.to_source, (3, 3)).T, np.float64)
        axes = (NOTHING, NOTHING) if self.screen is None else (self.screen.across, self.screen.down)
        pinned_by(self.source, H, MOST_TAPS, *axes, out)


def pinned(
    picture: NDArray[np.floating],
    target: tuple[int, int],
    H: NDArray[np.floating],
    across: Array = NOTHING,
    down: Array = NOTHING,
) -> Array:
    """Return a picture (height, width, 3) placed by H in a target (height, width), as the player places it.

    across, down : fields of `OnScreen`; empty without a screen.
    """
    placed = np.zeros((*target, CHANNELS), np.float32)
    source, axes = (
        np.ascontiguousarray(picture, np.float32),
        (np.ascontiguousarray(axis, np.float32) for axis in (across, down)),
    )
    pinned_by(source, np.ascontiguousarray(H, np.float64), MOST_TAPS, *axes, placed)
    return placed


@kernel(f"{PICTURE}, float64[:, ::1], int64, {PICTURE}, {PICTURE}, {PICTURE}")
def pinned_by(source: Array, H: NDArray[np.float64], most_taps: int, across: Array, down: Array, out: Array) -> None:
    """Place a picture by a projective map, with black around it. `across`, `down` : empty without a screen."""
    height, width = source.shape[:2]
    on_screen = across.shape[0] > 0
    for y in prange(out.shape[0]):
        for x in range(out.shape[1]):
            red, green, blue, total, cover = 0.0, 0.0, 0.0, 0.0, 0.0
            spot_x, spot_y, xx, xy, yx, yy = float(x), float(y), 1.0, 0.0, 0.0, 1.0
            if on_screen:
                spot_x, xx, xy = across[y, x, 0] - 0.5, across[y, x, 1], across[y, x, 2]
                spot_y, yx, yy = down[y, x, 0] - 0.5, down[y, x, 1], down[y, x, 2]
            u, v, w = projected(H, spot_x, spot_y)
            if w > 0 and (xx != 0 or xy != 0 or yx != 0 or yy != 0):
                a, b = H[0, 0] - u * H[2, 0], H[0, 1] - u * H[2, 1]
                reach_u = max(np.hypot(a * xx + b * yx, a * xy + b * yy) / w, TINY)
                a, b = H[1, 0] - v * H[2, 0], H[1, 1] - v * H[2, 1]
                reach_v = max(np.hypot(a * xx + b * yx, a * xy + b * yy) / w, TINY)
                cover = within(min(min(u, width - u) / reach_u, min(v, height - v) / reach_v) + 0.5, 0.0, 1.0)
            if cover > 0:
                first, last, every, wide = _taps(u, reach_u, width, most_taps)
                top, bottom, each, high = _taps(v, reach_v, height, most_taps)
                for row in range(top, bottom + 1, each):
                    share = max(0.0, 1 - abs(row + 0.5 - v) / high)
                    for column in range(first, last + 1, every):
                        weight = share * max(0.0, 1 - abs(column + 0.5 - u) / wide)
                        red += weight * source[row, column, 0]
                        green += weight * source[row, column, 1]
                        blue += weight * source[row, column, 2]
                        total += weight
            share = cover / total if total > 0 else 0.0
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = share * red, share * green, share * blue


@inlined
def _taps(centre: Any, reach: Any, count: Any, most: Any) -> Any:
    """Return the first and last sample of a tent filter, the step between samples, and its radius."""
    radius = max(reach, 1.0)
    first, last = np.ceil(centre - radius - 0.5), np.floor(centre + radius - 0.5)
    step = max(np.ceil(2 * radius / most), 1.0)
    return np.int64(max(first, 0.0)), np.int64(min(last, count - 1.0)), np.int64(step), radius
