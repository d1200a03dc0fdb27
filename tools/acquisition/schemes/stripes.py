"""Gray-coded stripes: locate each camera pixel in the projector picture with log₂ many pictures.

Unlike counterlight import-graycode, the captures are compared with half of the floodlight instead of an inverse
picture. This halves the number of pictures, and loses nothing where a pixel's light comes from one place. Half of the
far light reaches a pixel in every picture of narrow stripes, so half of the floodlight stays the right threshold.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.acquisition.plan import Pattern


@dataclass(frozen=True)
class Stripe:
    """One picture of stripes: axis 0 numbers rows, axis 1 columns; bit 0 is the finest, with stripes two cells wide."""

    projector: tuple[int, int]
    cell: int
    axis: int
    bit: int

    @property
    def width(self) -> int:
        """Width of a stripe in projector pixels."""
        return self.cell << (self.bit + 1)

    def paint(self) -> Pattern:
        cells = np.arange(self.projector[self.axis]) // self.cell
        line = (cells ^ (cells >> 1)) >> self.bit & 1 == 1
        return np.array(np.broadcast_to(line[:, None] if self.axis == 0 else line, self.projector))


def stripes(projector: tuple[int, int], cell: int) -> list[Stripe]:
    """Returns the stripes that number cells of `cell` projector pixels, per axis from coarse to fine."""
    bits = [max(0, (-(-side // cell) - 1).bit_length()) for side in projector]
    return [Stripe(projector, cell, axis, bit) for axis in (0, 1) for bit in reversed(range(bits[axis]))]


def locate(shown: Sequence[Stripe], lit_share: Sequence[FloatArray], projector: tuple[int, int]) -> FloatArray:
    """Returns the place that each camera pixel sees, the middle of a cell: (camera pixels, 2), row and column.

    lit_share : per stripe, (camera pixels,). Its light as a share of the floodlight.
    """
    pixels = lit_share[0].size if lit_share else 0
    place = np.zeros((pixels, 2))
    for axis in (0, 1):
        cell, code, binary = 1, np.zeros(pixels, np.int64), np.zeros(pixels, np.bool_)
        for stripe, share in zip(shown, lit_share, strict=True):
            if stripe.axis == axis:
                binary = binary ^ (share > 0.5)
                cell, code = stripe.cell, 2 * code + binary
        place[:, axis] = np.minimum((code + 0.5) * cell, projector[axis] - 0.5)
    return place
