"""Glare: a wide halo around each pixel of a device's picture, on coarse cells.

The halo is h = exp(−d / r) / (2π r²) at a distance of d pixels. A averages the picture over cells, K is h between the
centres of the cells, and V interpolates. A halo narrower than a cell becomes as wide as a cell.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.simulation.devices import Device
from counterlight.tools.transport.transport import Csr

MAX_CELLS = 1600
REACH = 8  # halo radii; 0.3 % of the halo is further out


@dataclass(frozen=True)
class Axis:
    """Cells of equal length along an axis of a picture of `pixels`, and `margin` more cells on each side."""

    pixels: int
    inside: int
    margin: int

    @property
    def cells(self) -> int:
        return self.inside + 2 * self.margin

    @property
    def step(self) -> float:
        """Length of a cell in pixels."""
        return self.pixels / self.inside

    def average(self) -> Csr:
        """Returns the means over cells, (cells, pixels); a pixel on a cell border counts in part."""
        edges = np.linspace(-self.margin, self.inside + self.margin, self.cells + 1) * self.step
        pixels = np.arange(self.pixels)
        overlap = np.minimum(edges[1:, None], pixels + 1) - np.maximum(edges[:-1, None], pixels)
        return Csr(np.maximum(overlap, 0) / self.step)

    def place(self, at: FloatArray) -> FloatArray:
        """Returns pixel coordinates in cells from the centre of the first cell."""
        return np.clip(at / self.step - 0.5 + self.margin, 0, self.cells - 1)

    def interpolate(self) -> Csr:
        """Returns linear interpolation between the centres of the cells, (pixels, cells)."""
        place = self.place(np.linspace(0.5, self.pixels - 0.5, self.pixels))
        return Csr(np.maximum(0, 1 - np.abs(place[:, None] - np.arange(self.cells))))


@dataclass(frozen=True)
class Halo:
    """The halo of a device.

    x, y : cells of the picture.
    radius : r, pixels.
    """

    x: Axis
    y: Axis
    radius: float

    @property
    def cells(self) -> int:
        return self.x.cells * self.y.cells

    @property
    def average(self) -> Csr:
        """A, (cells, pixels)."""
        return Csr(sparse.kron(self.y.average(), self.x.average()))

    @property
    def interpolate(self) -> Csr:
        """V, (pixels, cells)."""
        return Csr(sparse.kron(self.y.interpolate(), self.x.interpolate()))

    @cached_property
    def kernel(self) -> FloatArray:
        """K, (cells, cells)."""
        y, x = np.divmod(np.arange(self.cells), self.x.cells)
        apart = np.hypot((x[:, None] - x) * self.x.step, (y[:, None] - y) * self.y.step)
        return np.asarray(np.exp(-apart / self.radius) / self._whole())

    def between(self, x: FloatArray, y: FloatArray) -> list[tuple[IntArray, FloatArray]]:
        """Returns the four cells around places of the picture, with their bilinear weights."""
        across, down = self.x.place(x), self.y.place(y)
        i, j = (np.minimum(at.astype(np.int64), axis.cells - 2) for at, axis in ((across, self.x), (down, self.y)))
        s, t = across - i, down - j
        corners = ((0, 0, (1 - s) * (1 - t)), (0, 1, s * (1 - t)), (1, 0, (1 - s) * t), (1, 1, s * t))
        return [((j + below) * self.x.cells + i + right, weight) for below, right, weight in corners]

    def _whole(self) -> float:
        """Returns the sum of exp(−d / r) over all cells of an infinite picture."""
        steps = self.x.step, self.y.step
        x, y = (np.arange(-n, n + 1) * step for step in steps for n in [int(np.ceil(REACH * self.radius / step))])
        return float(np.exp(-np.hypot(x[:, None], y) / self.radius).sum())


def halo_of(device: Device, angle: float, beyond: float = 0.0) -> Halo:
    """Returns the halo of a radius of `angle` (radians), which reaches `beyond` radii over the picture's border."""
    radius = np.tan(angle) * device.width / (2 * device.tan_half[0])
    width, height = (size + 2 * beyond * radius for size in (device.width, device.height))
    step = max(1.0, np.sqrt(width * height / MAX_CELLS))
    x, y = (_axis(size, step, beyond * radius) for size in (device.width, device.height))
    return Halo(x, y, radius)


def _axis(pixels: int, step: float, beyond: float) -> Axis:
    inside = max(1, int(pixels / step))
    return Axis(pixels, inside, int(np.ceil(beyond * inside / pixels)))
