"""Fit the spots that camera pixels see: Gaussians at their places, changed as little as random pictures require.

t = g + Z z with z of unit variance. Z moves each projector pixel of the window separately, and the Gaussian's place and
width as a whole, which carry the largest errors. With white noise this is regularised least squares per camera pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.tools.acquisition.few.far import Far
from counterlight.tools.acquisition.few.places import Spots, along
from counterlight.tools.acquisition.few.seen import Seen, Table, some
from counterlight.tools.transport.transport import Shape

LEAST_REACH, MOST_REACH = 3, 6  # limits of the distance from a spot's middle to its window's edge, in projector pixels
REACH = 3.0  # standard deviations of a spot from its middle to its window's edge
# standard deviations of a pixel in a window: SHAPE relative to the pixel's share, FLOOR relative to all light
SHAPE, FLOOR = 0.15, 0.002
# standard deviations of a Gaussian's place (projector pixels) and of its width (relative to the width)
PLACE, WIDTH = 0.1, 0.15
# relative standard deviation between a pixel's far light and its surroundings' far light: OWN inside, AT_BORDER at the
# border
OWN, AT_BORDER = 0.05, 0.5
MOST_FAR = 0.95  # largest share of far light in a pixel's light
BORDER = 1.5  # projector pixels; spots with a middle nearer to the raster's border count as cut
STEP = 0.02  # step of finite differences
FAINTEST = 4e-3  # share of a spot's brightest pixel; fainter pixels are dropped as noise


@dataclass(frozen=True)
class Windows:
    """The projector pixels around spots.

    pixel : (n,). Camera pixels.
    place, width : (n, 2). Place and width of their Gaussians.
    projector : (height, width).
    reach : projector pixels from the middle of a window to its edge.
    """

    pixel: IntArray
    place: FloatArray
    width: FloatArray
    projector: Shape
    reach: int

    @classmethod
    def around(cls, spots: Spots, far: FloatArray, projector: Shape) -> "Windows":
        """Make the windows of all camera pixels with a place; `far` is their share of far light, (camera pixels,)."""
        pixel = np.flatnonzero(spots.seen)
        width = spots.widths(far)[pixel]
        wide = float(np.percentile(width, 95)) if len(width) else 0.0
        return cls(
            pixel, spots.place[pixel], width, projector, int(np.clip(np.ceil(REACH * wide), LEAST_REACH, MOST_REACH))
        )

    def of(self, chosen: IntArray | slice) -> "Windows":
        return Windows(self.pixel[chosen], self.place[chosen], self.width[chosen], self.projector, self.reach)

    @property
    def size(self) -> int:
        """Projector pixels per window."""
        return (2 * self.reach + 1) ** 2

    @cached_property
    def _lines(self) -> tuple[IntArray, IntArray]:
        """Rows and columns of the windows' projector pixels, (n, side) each."""
        rows, columns = (along(self.place[:, axis], self.width[:, axis], self.reach)[0] for axis in range(2))
        return rows, columns

    @cached_property
    def inside(self) -> FloatArray:
        """(n, window), 1 for pixels inside the projector, else 0."""
        (rows, columns), (height, width) = self._lines, self.projector
        there = ((rows >= 0) & (rows < height))[:, :, None] & ((columns >= 0) & (columns < width))[:, None]
        return there.reshape(len(rows), -1).astype(np.float64)

    @cached_property
    def columns(self) -> IntArray:
        """(n, window), projector pixels; 0 for pixels outside the projector."""
        rows, columns = self._lines
        numbers = rows[:, :, None] * self.projector[1] + columns[:, None]
        return np.where(self.inside > 0, numbers.reshape(len(rows), -1), 0)

    def gaussian(self, place: FloatArray | float = 0.0, width: FloatArray | float = 1.0) -> FloatArray:
        """Returns Gaussian shares of light, (n, window), that sum to 1.

        place : (2,). Added to the places.
        width : (2,). Multiplies the widths.
        """
        moved, scaled = self.place + place, self.width * width
        lines = [self._share(moved[:, axis], scaled[:, axis], axis) for axis in range(2)]
        spot = (lines[0][:, :, None] * lines[1][:, None]).reshape(len(self.pixel), -1) * self.inside
        return np.asarray(spot / np.maximum(spot.sum(axis=1, keepdims=True), 1e-9))

    def _share(self, place: FloatArray, width: FloatArray, axis: int) -> FloatArray:
        """Returns a moved Gaussian's shares along one axis, on the pixels of the unmoved window."""
        middle = np.rint(self.place[:, axis])
        pixels, shares = along(place - middle, width, self.reach + 1)
        first = (-self.reach - pixels[:, 0])[:, None] + np.arange(2 * self.reach + 1)
        return np.take_along_axis(shares, first, axis=1)

    @cached_property
    def start(self) -> FloatArray:
        """g, (n, window)."""
        return self.gaussian()

    @cached_property
    def freedom(self) -> FloatArray:
        """The part of Z that changes places and widths, (n, 4, window)."""
        spots = []
        for axis in np.eye(2):
            spots.append((self.gaussian(place=STEP * axis) - self.gaussian(place=-STEP * axis)) * PLACE / (2 * STEP))
            spots.append(
                (self.gaussian(width=1 + STEP * axis) - self.gaussian(width=1 - STEP * axis)) * WIDTH / (2 * STEP)
            )
        return np.stack(spots, axis=1)

    @property
    def at_border(self) -> BoolArray:
        """(n,) bool. Whether the raster's border cuts the spot; a cut spot has less near light."""
        first, last = -0.5 + BORDER, np.array(self.projector) - 0.5 - BORDER
        return np.asarray(np.any((self.place < first) | (self.place > last), axis=1))

    @cached_property
    def spread(self) -> FloatArray:
        """The part of Z that changes single pixels, (n, window)."""
        return self.inside * (SHAPE * self.start + FLOOR)

    def freed(self, A: NDArray[np.floating]) -> FloatArray:
        """Returns A Z, (n, equations, window + 4)."""
        return np.concatenate([A * self.spread[:, None], np.einsum("new,nfw->nef", A, self.freedom)], axis=2)


def near_light(
    seen: Seen, table: Table, windows: Windows, far: Far, pictures: Sequence[int]
) -> tuple[NDArray[np.float32], Far]:
    """Returns the most likely t, (n, window), given the pictures, and far light with each camera pixel's own share."""
    kernel, own = np.empty((len(windows.pixel), windows.size), np.float32), far.own.copy()
    for part in some(windows.pixel, 6 * max(len(pictures), 1) * windows.size):
        here = windows.of(part)
        if not pictures:
            kernel[part] = _cleaned(here.start)
            continue
        bent, more = _bent(seen, table, here, far, pictures)
        kernel[part] = _cleaned(bent)
        own[here.pixel] *= np.clip(1 + more, 0, MOST_FAR / np.maximum(far.total[here.pixel].max(axis=1), 1e-3))[:, None]
    return kernel, _elsewhere(replace(far, own=own), windows)


def _bent(
    seen: Seen, table: Table, windows: Windows, far: Far, pictures: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Returns t, and each pixel's relative excess of far light over its surroundings."""
    pixels = windows.pixel
    A = seen.drive(table, far.near_mixture[pixels], windows.columns, pictures)
    target, sigma = seen.targets(pixels, pictures)
    distant, close = far.seen(pixels, pictures), np.einsum("new,nw->ne", A, windows.start)
    # Far light is subtracted from near light; its share is about the same for each primary.
    share = far.total[pixels].mean(axis=1)[:, None]
    spread = np.where(windows.at_border, AT_BORDER, OWN)
    more = spread[:, None] * (distant - share / (1 - share) * close)
    A /= sigma[..., None]
    free = np.concatenate([windows.freed(A), (more / sigma)[..., None]], axis=2)
    z = ridge(free, (target - distant - close) / sigma)
    single, whole, own = np.split(z, np.cumsum([windows.start.shape[1], windows.freedom.shape[1]]), axis=1)
    kernel = windows.start + windows.spread * single + np.einsum("nf,nfw->nw", whole, windows.freedom)
    return kernel, spread * own[:, 0]


def _elsewhere(far: Far, windows: Windows) -> Far:
    """Give camera pixels without a place only far light, if the room has any."""
    own = np.divide(1, far.around, out=np.zeros_like(far.around), where=far.around > 0)
    own[windows.pixel] = far.own[windows.pixel]
    return replace(far, own=own)


def ridge(A: FloatArray, y: FloatArray) -> FloatArray:
    """Minimise ‖A z − y‖² + ‖z‖² for many A (n, equations, unknowns) and y (n, equations); z is (n, unknowns)."""
    turned = A.transpose(0, 2, 1)
    if A.shape[1] < A.shape[2]:
        return np.asarray(turned @ np.linalg.solve(A @ turned + np.eye(A.shape[1]), y[..., None]))[..., 0]
    return np.asarray(np.linalg.solve(turned @ A + np.eye(A.shape[2]), turned @ y[..., None]))[..., 0]


def _cleaned(kernel: FloatArray) -> FloatArray:
    """Remove negative and very faint entries, and scale each kernel to sum 1."""
    kept = np.where(kernel > FAINTEST * kernel.max(axis=1, keepdims=True), kernel, 0)
    return np.asarray(kept / np.maximum(kept.sum(axis=1, keepdims=True), 1e-9))
