"""The pictures in order of importance; an acquisition of any length shows the first pictures of this order.

1. Black.
2. Red, green and blue, whose sum is the floodlight.
3. Ramps of three directions in three colours. They give the projector's response and the rough place of each spot.
4. Grey sines (phase shifts; Srinivasan et al. 1984). They give the exact place and the width of the spot.
5. Random pictures, independent in red, green and blue. They tell three times as much about the shapes of spots and
   about far light as black-and-white pictures. An occasional white tests whether light adds up and whether anything
   moved.

No picture depends on another picture's capture or on the number of pictures.

Several projectors take turns: black once, then a picture of each in turn, while the others are black.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.raster import Shapes, side_by_side
from counterlight.tools.acquisition.plan import Codes, LazyPatterns
from counterlight.tools.transport.transport import Shape

BLACK, PRIMARIES, RAMPS, FIRST_SINE = 0, (1, 2, 3), 4, 5
# periods of sines in projector pixels; shorter periods would pull places towards the pixels' middles
PERIOD, LONG_PERIOD = 8, 64
ONE_PERIOD = 256  # side in pixels up to which a ramp resolves periods of 8 pixels
PHASES = 0.0, np.pi / 2
WHITE_EVERY = 32  # every WHITE_EVERY random pictures, white is shown once
CELLS = 8  # cells along the longer side; a random picture is mostly lit or mostly dark in each cell
MOSTLY = 0.85
DARKEST = 40  # least code value of ramps; below it, light hardly changes with the place
ENCODING = 2.2  # gamma of sines; gives about even steps of light on most projectors
SEED = 19840918


@dataclass(frozen=True)
class Wave:
    """A sine along an axis.

    axis : 0 for y, 1 for x.
    period : projector pixels.
    phase : phase of its crest, radians.
    """

    axis: int
    period: int
    phase: float

    def codes(self, size: int) -> NDArray[np.uint8]:
        """Returns code values along the axis, (size,)."""
        place = np.arange(size) + 0.5
        light = 0.5 + 0.5 * np.cos(2 * np.pi * place / self.period - self.phase)
        return np.rint(255 * light ** (1 / ENCODING)).astype(np.uint8)


@dataclass(frozen=True)
class Order:
    """The pictures of a projector of (height, width)."""

    projector: Shape

    @cached_property
    def sines(self) -> list[Wave]:
        """All sines: per axis the periods from long to short, two phases each."""
        return [
            Wave(axis, period, phase)
            for axis, size in enumerate(self.projector)
            for period in ((PERIOD,) if size <= ONE_PERIOD else (LONG_PERIOD, PERIOD))
            for phase in PHASES
        ]

    @property
    def least(self) -> int:
        """The least number of pictures that make a room."""
        return FIRST_SINE + len(self.sines)

    def sine(self, axis: int, period: int) -> list[int]:
        """Returns the numbers of the two phases of an axis and period."""
        return [FIRST_SINE + i for i, wave in enumerate(self.sines) if (wave.axis, wave.period) == (axis, period)]

    def is_white(self, index: int) -> bool:
        return index == self.least or (index > self.least and index % WHITE_EVERY == WHITE_EVERY - 1)

    def whites(self, count: int) -> list[int]:
        return [index for index in range(count) if self.is_white(index)]

    def random(self, count: int) -> list[int]:
        return [index for index in range(self.least, count) if not self.is_white(index)]

    def pictures(self, count: int) -> Sequence[Codes]:
        """Returns the first `count` pictures."""
        return LazyPatterns(count, self.codes)

    def codes(self, index: int) -> Codes:
        """Returns picture `index`, (height, width, 3)."""
        height, width = self.projector
        if index == BLACK:
            return np.zeros((height, width, 3), np.uint8)
        if index in PRIMARIES:
            return np.broadcast_to(255 * np.eye(3, dtype=np.uint8)[index - 1], (height, width, 3)).copy()
        if index == RAMPS:
            return np.rint(DARKEST + (255 - DARKEST) * self.ramps).astype(np.uint8)
        if index < self.least:
            wave = self.sines[index - FIRST_SINE]
            line = wave.codes(self.projector[wave.axis])
            grey = np.broadcast_to(line[:, None] if wave.axis == 0 else line, (height, width))
            return np.repeat(grey[..., None], 3, axis=2)
        if self.is_white(index):
            return np.full((height, width, 3), 255, np.uint8)
        return self._noise(index)

    @cached_property
    def ramps(self) -> FloatArray:
        """Ramps, (height, width, 3): red rightwards, green downwards, blue both; 0 to 1 for codes DARKEST to 255."""
        y, x = ((np.arange(size) + 0.5) / size for size in self.projector)
        down, right = np.broadcast_arrays(y[:, None], x)
        return np.stack([right, down, (right + down) / 2], axis=2)

    def _noise(self, index: int) -> Codes:
        rng = np.random.default_rng((SEED, index))
        side = -(-max(self.projector) // CELLS)
        cells: IntArray = np.add.outer(
            np.arange(self.projector[0]) // side * CELLS, np.arange(self.projector[1]) // side
        )
        mostly = (rng.random((CELLS * CELLS, 3)) < 0.5)[cells]
        lit = rng.random((*self.projector, 3)) < np.where(mostly, MOSTLY, 1 - MOSTLY)
        return np.where(lit, np.uint8(255), np.uint8(0))


@dataclass(frozen=True)
class Turns:
    """The turns of projectors of (height, width), from the left of the raster."""

    projectors: Shapes

    @cached_property
    def orders(self) -> list[Order]:
        return [Order(projector) for projector in self.projectors]

    @property
    def least(self) -> int:
        """The least number of pictures in total that make a room."""
        return self.in_all(max(order.least for order in self.orders))

    def of_each(self, count: int) -> int:
        """Returns the pictures per projector, black included, of `count` pictures in total."""
        return 1 + (count - 1) // len(self.projectors)

    def in_all(self, of_each: int) -> int:
        return 1 + (of_each - 1) * len(self.projectors)

    def numbers(self, projector: int, of_each: int) -> list[int]:
        """Returns the capture numbers of a projector, which is numbered from 0."""
        return [BLACK, *range(1 + projector, self.in_all(of_each), len(self.projectors))]

    def pictures(self, count: int) -> Sequence[Codes]:
        """Returns the first `count` pictures of the raster."""
        return LazyPatterns(count, self._codes)

    def _codes(self, number: int) -> Codes:
        round_, projector = divmod(number - 1, len(self.projectors))
        own = self.orders[projector].codes(BLACK if number == BLACK else 1 + round_)
        if len(self.projectors) == 1:
            return own
        (height, width), regions = side_by_side(self.projectors)
        shown = np.zeros((height, width, 3), np.uint8)
        shown[regions[projector].part] = own
        return shown
