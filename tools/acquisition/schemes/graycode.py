"""Direct mapping by Gray code as a scheme, for comparison (thesis 6.1)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.passes.colour import LUMINANCE
from counterlight.tools.acquisition.direct_mapping import direct_mapping, direct_transport
from counterlight.tools.acquisition.plan import (
    Captures,
    Expected,
    LazyPatterns,
    Level,
    Measured,
    Pattern,
    Reference,
    Scheme,
)

FILL_RADIUS = 4  # cells, as in counterlight import-graycode
SURE_SIGMAS = 4.0


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


@dataclass(frozen=True)
class GrayCodeScheme:
    """Stripes and their inverses down to single pixels; each camera pixel sees one projector pixel (thesis 6.1)."""

    def expected(self, projector: tuple[int, int]) -> tuple[Expected, ...]:
        return (Expected(2 * len(stripes(projector, 1))),)

    def __call__(self, room: Reference, projector: tuple[int, int]) -> Scheme:
        shown = stripes(projector, 1)
        count = 2 * len(shown)
        patterns = LazyPatterns(count, lambda i: shown[i // 2].paint() ^ (i % 2 == 1))
        captures = yield Level("stripes and inverses", patterns, cover=len(shown))
        valid, place = self._decode(room, captures, shown, projector)
        shape = room.black.shape[:2]
        y, x = (np.floor(place[:, axis]).astype(np.int32).reshape(shape) for axis in (0, 1))
        mapping = direct_mapping(x, y, valid.reshape(shape), projector, fill_radius=FILL_RADIUS)
        weight = np.maximum(room.light, 0).astype(np.float32)
        decoded = f"{int(valid.sum())} of {valid.size} camera pixels decoded"
        return Measured(direct_transport(mapping, weight), (decoded,))

    def _decode(
        self, room: Reference, captures: Captures, shown: Sequence[Stripe], projector: tuple[int, int]
    ) -> tuple[NDArray[np.bool_], FloatArray]:
        """Returns which camera pixels are sure in every bit, and the place that each sees, (camera pixels, 2)."""
        flood, shares = room.light @ LUMINANCE, []
        sigma = np.sqrt(2 * (room.noise.sigma(room.light / 2) ** 2) @ np.square(LUMINANCE))
        sure = np.any(room.light > SURE_SIGMAS * room.noise.sigma(room.light), axis=1)
        for i in range(len(shown)):
            difference = (np.asarray(captures[2 * i], np.float64) - captures[2 * i + 1]).reshape(-1, 3) @ LUMINANCE
            sure &= np.abs(difference) > SURE_SIGMAS * sigma
            shares.append(0.5 + difference / np.where(flood > 0, 2 * flood, np.inf))
        place = locate(shown, shares, projector)
        return sure, place
