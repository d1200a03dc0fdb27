"""Baseline acquisition schemes: pixel by pixel, and fixed blocks.

They see the same room through the same captures as the hierarchical scheme, and also return a light transport.
"""

from dataclasses import dataclass

import numpy as np

from counterlight.errors import InputError
from counterlight.passes.colour import LUMINANCE
from counterlight.tools.acquisition.plan import Captures, Expected, LazyPatterns, Level, Measured, Reference, Scheme
from counterlight.tools.acquisition.schemes.blocks import (
    BlockGrid,
    BlockLight,
    as_transport,
    fit_to_composition,
    joined,
)
from counterlight.tools.acquisition.schemes.hierarchical import DEFAULT, Threshold

ALL_PAIRS = Threshold(6.0)


@dataclass(frozen=True)
class PixelByPixelScheme:
    """Every projector pixel alone, T column by column (thesis 3.4.2).

    In every pair of camera and projector pixel, noise may look like light; the threshold is therefore higher.
    """

    threshold: Threshold = ALL_PAIRS

    def expected(self, projector: tuple[int, int]) -> tuple[Expected, ...]:
        return (Expected(projector[0] * projector[1]),)

    def __call__(self, room: Reference, projector: tuple[int, int]) -> Scheme:
        grid = BlockGrid(projector, 1)
        captures = yield Level("pixels", LazyPatterns(grid.count, lambda i: grid.paint(np.array([i]))), cover=1)
        part = _columns(room, captures, grid, self.threshold)
        return Measured(as_transport(fit_to_composition([part], room.light), len(room.light)))


@dataclass(frozen=True)
class FixedBlocksScheme:
    """Blocks that are assumed not to disturb each other (Masselus et al. 2003, Relighting with 4D incident light
    fields).

    Each block is shown alone, and a camera pixel belongs to the block that it sees best. Then the first pixels of all
    blocks are shown together, the second pixels, and so on. A camera pixel's light is attributed to its own block.

    side : side of a block in projector pixels.
    """

    side: int = 16
    threshold: Threshold = DEFAULT

    def __post_init__(self) -> None:
        if self.side < 1:
            raise InputError(f"block side {self.side}: expected at least 1 projector pixel")

    def expected(self, projector: tuple[int, int]) -> tuple[Expected, ...]:
        return Expected(BlockGrid(projector, self.side).count), Expected(self.side**2)

    def __call__(self, room: Reference, projector: tuple[int, int]) -> Scheme:
        blocks, pixels = BlockGrid(projector, self.side), BlockGrid(projector, 1)
        shown = LazyPatterns(blocks.count, lambda i: blocks.paint(np.array([i])))
        captures = yield Level("blocks", shown, self.expected(projector)[1:], cover=1)
        owner, best = np.zeros(len(room.light), np.int64), np.zeros(len(room.light))
        for block in range(blocks.count):
            light = room.above_black(captures[block]) @ LUMINANCE
            owner, best = np.where(light > best, block, owner), np.maximum(light, best)
        row, column = np.mgrid[: projector[0], : projector[1]] % self.side
        place = row * self.side + column
        captures = yield Level("pixels", LazyPatterns(self.side**2, lambda i: np.asarray(place == i)), cover=1)
        parts = []
        for i in range(len(captures)):
            y, x = np.divmod(owner, blocks.columns)
            y, x = y * self.side + i // self.side, x * self.side + i % self.side
            inside = (y < projector[0]) & (x < projector[1])
            light = room.above_black(captures[i])
            lit = np.flatnonzero(inside & np.any(light >= self.threshold.of(room), axis=1))
            parts.append(BlockLight(pixels, lit, (y * projector[1] + x)[lit], np.maximum(light[lit], 0)))
        part = joined(parts)
        return Measured(as_transport(fit_to_composition([part], room.light), len(room.light)))


def _columns(room: Reference, captures: Captures, grid: BlockGrid, threshold: Threshold) -> BlockLight:
    """Returns the light above τ in each capture i, which shows block i alone."""
    tau, parts = threshold.of(room), []
    for block in range(grid.count):
        light = room.above_black(captures[block])
        camera = np.flatnonzero(np.any(light >= tau, axis=1))
        parts.append(BlockLight(grid, camera, np.full(camera.size, block), np.maximum(light[camera], 0)))
    return joined(parts)
