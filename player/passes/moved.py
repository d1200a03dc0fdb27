"""The drive for projectors whose pictures have moved since the calibration (pipeline/drift.py)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.passes.drawing import Array, Pass, Picture
from counterlight.passes.kernel import PICTURE, inlined, kernel, prange, projected, within

TAPS = 6  # interpolation uses TAPS × TAPS pixels
# distance, in pixels, to which a moved picture continues beyond the calibrated raster, and over which it then fades
WHOLE, FADE = 1.0, 2.0


@dataclass(frozen=True, eq=False)
class MovedDrive(Pass[Picture]):
    """p(N x) / g for every pixel x of every projector.

    projectors : (projectors, 6, 3), from `Drift.table`.
    """

    shader = "moved.frag"
    drive: Picture
    projectors: Picture

    def fill(self: "MovedDrive[Array]", out: Array) -> None:
        for rows in self.projectors.astype(np.float64):
            region = [int(value) for value in (*rows[3, :2], *rows[4, :2])]
            moved(self.drive, rows[:3], rows[5], *region, out)


@kernel(f"{PICTURE}, float64[:, ::1], float64[::1], int64, int64, int64, int64, {PICTURE}")
def moved(
    drive: Array,
    N: NDArray[np.float64],
    light: NDArray[np.float64],
    left: int,
    top: int,
    width: int,
    height: int,
    out: Array,
) -> None:
    """Compute one projector's part of the drive for its current position."""
    for y in prange(height):
        for x in range(width):
            u, v, w = projected(N, x, y)
            red, green, blue, lands = 0.0, 0.0, 0.0, 0.0
            if w > 0:
                across, down = 1 + (min(u, width - u) + WHOLE) / FADE, 1 + (min(v, height - v) + WHOLE) / FADE
                lands = within(across, 0.0, 1.0) * within(down, 0.0, 1.0)
            if lands > 0:
                first, above = np.floor(u - 0.5), np.floor(v - 0.5)
                of_column, of_row = _keys(u - 0.5 - first), _keys(v - 0.5 - above)
                for i in range(TAPS):
                    row = top + _mirrored(np.int64(above) + i - 2, height - 1)
                    for j in range(TAPS):
                        column = left + _mirrored(np.int64(first) + j - 2, width - 1)
                        weight = lands * of_row[i] * of_column[j]
                        red += weight * drive[row, column, 0]
                        green += weight * drive[row, column, 1]
                        blue += weight * drive[row, column, 2]
            out[top + y, left + x, 0] = within(red / light[0], 0.0, 1.0)
            out[top + y, left + x, 1] = within(green / light[1], 0.0, 1.0)
            out[top + y, left + x, 2] = within(blue / light[2], 0.0, 1.0)


@inlined
def _keys(t: Any) -> Any:
    """Return the weights of six neighbouring pixels for a point at t, 0 to 1, between the inner two (drift.py)."""
    return _far(2 + t), _middle(1 + t), _near(t), _near(1 - t), _middle(2 - t), _far(3 - t)


@inlined
def _near(x: Any) -> Any:
    return (4 * x - 7) * x * x / 3 + 1


@inlined
def _middle(x: Any) -> Any:
    return ((36 - 7 * x) * x - 59) * x / 12 + 2.5


@inlined
def _far(x: Any) -> Any:
    return ((x - 8) * x + 21) * x / 12 - 1.5


@inlined
def _mirrored(index: Any, last: Any) -> Any:
    """Return an index reflected at both ends of a line; the outermost pixel is not repeated."""
    return within(last - abs(last - abs(index)), 0, last)
