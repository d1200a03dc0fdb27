"""Which pictures to show, in order of importance: however many there are, they are the first ones of all.

Black; red, green and blue, whose sum is the floodlight; ramps of three directions in three colours, by which one knows
roughly where a camera pixel looks, and how the projector's light follows the code; grey sines (phase shifts; Srinivasan
et al. 1984), by which one knows exactly, and how wide a spot it sees. With those every camera pixel has a place. All
others are random, red, green and blue each by itself: of the shapes of spots and of far light they say three times as
much as black and white ones. White now and then says whether light adds up, and whether something moved.

No picture depends on another one's capture, nor on how many are to come.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.acquisition.plan import Codes, LazyPatterns
from counterlight.tools.transport.transport import Shape

BLACK, PRIMARIES, RAMPS, FIRST_SINE = 0, (1, 2, 3), 4, 5
PERIOD, LONG_PERIOD = 8, 64  # projector pixels; shorter ones are pulled towards the pixels' middles
ONE_PERIOD = 256  # pixels a side up to which a ramp tells periods of 8 apart
PHASES = 0.0, np.pi / 2
WHITE_EVERY = 32  # pictures
CELLS = 8  # along the longer side; a random picture is mostly lit or mostly dark in each
MOSTLY = 0.85
DARKEST = 40  # code of ramps: below, places hardly change the light
ENCODING = 2.2  # of sines: what most projectors take for about even steps of light
SEED = 19840918


@dataclass(frozen=True)
class Wave:
    """A sine along an axis, 0 for y and 1 for x.  period : projector pixels.  phase : of its crest, in radians."""

    axis: int
    period: int
    phase: float

    def codes(self, size: int) -> NDArray[np.uint8]:
        """(size,), along the axis."""
        place = np.arange(size) + 0.5
        light = 0.5 + 0.5 * np.cos(2 * np.pi * place / self.period - self.phase)
        return np.rint(255 * light ** (1 / ENCODING)).astype(np.uint8)


@dataclass(frozen=True)
class Order:
    """projector : (height, width)."""

    projector: Shape

    @cached_property
    def sines(self) -> list[Wave]:
        """Of each axis one period after the other, two phases of each, the exact one last."""
        return [
            Wave(axis, period, phase)
            for axis, size in enumerate(self.projector)
            for period in ((PERIOD,) if size <= ONE_PERIOD else (LONG_PERIOD, PERIOD))
            for phase in PHASES
        ]

    @property
    def least(self) -> int:
        """Pictures without which there is no room."""
        return FIRST_SINE + len(self.sines)

    def sine(self, axis: int, period: int) -> list[int]:
        """The pictures of an axis' two phases."""
        return [FIRST_SINE + i for i, wave in enumerate(self.sines) if (wave.axis, wave.period) == (axis, period)]

    def is_white(self, index: int) -> bool:
        return index == self.least or (index > self.least and index % WHITE_EVERY == WHITE_EVERY - 1)

    def whites(self, count: int) -> list[int]:
        return [index for index in range(count) if self.is_white(index)]

    def random(self, count: int) -> list[int]:
        return [index for index in range(self.least, count) if not self.is_white(index)]

    def pictures(self, count: int) -> Sequence[Codes]:
        """The first so many."""
        return LazyPatterns(count, self.codes)

    def codes(self, index: int) -> Codes:
        """(height, width, 3)."""
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
        """Red rightwards, green downwards, blue both, 0..1 from code DARKEST to 255: (height, width, 3)."""
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
