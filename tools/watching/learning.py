"""Learn what stays: factors g of the rows of T, from the same residuals in minutes of changing film.

The model of a block is c = g (T W(θ) p + e(θ)) + o, per channel. Dust, a stain or a fallen poster dim the light of the
room as well, so g covers e. The offset o is fitted and forgotten, so that no error of e is taken for a factor.
g = Σ w (x − x̄)(c − c̄) / Σ w (x − x̄)², with the predicted light x and weights w = 1 / σ². These sums are kept for the
last PARTS parts of the film. A part takes PART_S, or longer until the film determines the block's g to UNSURE.
A person who stays for a part makes the parts disagree.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from counterlight.arrays import BoolArray, FloatArray
from counterlight.tools.watching.estimate import WORTH
from counterlight.unattended.watch_link import ROW_GAINS

PARTS, PART_S = 5, 60.0
UNSURE = 0.03  # standard deviation of a part's g
AGREED = 0.05  # largest distance of a part's g from the mean of all parts
CLEAR, FAINT = 0.05, 0.015  # distances of g from 1: of a square of SQUARE blocks, and of blocks connected with it
SQUARE = np.ones((3, 3), np.bool_)  # thin lines are edges that a camera sees elsewhere, not changes of the wall
BEYOND = 0.1  # share of a region's blocks beyond the limits from which on the region is left alone


@dataclass(frozen=True)
class Learned:
    """g of every block, (blocks, 3), and the share of the counted blocks with a g beyond the limits."""

    gains: FloatArray
    beyond: float = 0.0


class Learning:
    """Collects comparisons, and learns g from them. Only the times that are given count.

    shape : (rows, columns) of the blocks.
    counted : (blocks,) bool.
    """

    def __init__(self, shape: tuple[int, int], counted: BoolArray) -> None:
        self._shape, self._counted = shape, counted
        self.learned = Learned(np.ones((counted.size, 3)))
        self.restart(self.learned.gains)

    def restart(self, gains: FloatArray) -> None:
        """Forget all comparisons, and continue from g."""
        self.learned = Learned(gains, self.learned.beyond)
        self._sums = np.zeros((PARTS + 1, 2, 5, self._counted.size, 3))  # the part that is filled, then the newest
        self._begun_s, self._count = np.inf, 0

    def add(self, time_s: float, predicted: FloatArray, measured: FloatArray, weights: FloatArray) -> None:
        """Take a comparison: x, c and w, (blocks, 3). Every third comparison is held back."""
        self._count += 1
        w, wx = weights, weights * predicted
        self._sums[0, int(self._count % 3 == 0)] += np.stack([w, wx, w * measured, wx * predicted, wx * measured])
        self._begun_s = min(self._begun_s, time_s)
        if time_s - self._begun_s >= PART_S:
            self._begun_s = time_s
            self._end_part()
            self._learn()

    def _end_part(self) -> None:
        """Keep the part of the blocks that it determines. The other blocks continue."""
        done = _spread(self._sums[0, 0])[0] > UNSURE**-2
        self._sums[1:, ..., done] = self._sums[:-1, ..., done]
        self._sums[0][..., done] = 0

    def _learn(self) -> None:
        """Take g of the regions in which it predicts the held-back comparisons better than the present g."""
        present = self.learned.gains
        found, beyond = self._found(present)
        differs = np.any(found != present, axis=1)
        xx, xc = (each.sum(axis=0) for each in _spread(self._sums[1:, 1].swapaxes(0, 1)))
        better = np.sum(xc * (found - present) - 0.5 * xx * (found**2 - present**2), axis=1)
        label = ndimage.label(differs.reshape(self._shape), SQUARE)[0].ravel()
        worth = (np.bincount(label, better) > WORTH)[label] & differs
        self.learned = Learned(np.where(worth[:, None], found, present), beyond)

    def _found(self, present: FloatArray) -> tuple[FloatArray, float]:
        """Return g by the fitted comparisons, (blocks, 3), and `Learned.beyond`. An unknown g keeps its value."""
        xx, xc = _spread(self._sums[1:, 0].swapaxes(0, 1))
        parts, g = xc / np.maximum(xx, 1e-12), xc.sum(axis=0) / np.maximum(xx.sum(axis=0), 1e-12)
        known = np.all(xx > UNSURE**-2, axis=0) & (np.abs(parts - g).max(axis=0) < AGREED)
        known &= self._counted[:, None]
        if known.sum() < 0.5 * 3 * self._counted.sum():
            return present, self.learned.beyond
        g /= [np.median(g[known[:, k], k]) if known[:, k].any() else 1.0 for k in range(3)]  # the lamp's part
        away = np.where(known, np.abs(g - 1), 0).max(axis=1).reshape(self._shape)
        core = ndimage.binary_opening(away > CLEAR, SQUARE)
        region, count = ndimage.label(ndimage.binary_propagation(core, SQUARE, away > FAINT), SQUARE)
        out = np.any(known & ((g < ROW_GAINS[0]) | (g > ROW_GAINS[1])), axis=1).reshape(self._shape)
        share = ndimage.mean(out, region, np.arange(count + 1))
        left = np.isin(region, np.flatnonzero(share > BEYOND)) & (region > 0)
        inside = ((region > 0) & ~left).reshape(-1, 1)
        known &= ~left.reshape(-1, 1)
        found = np.where(known, np.where(inside, np.clip(g, *ROW_GAINS), 1), present)
        return found, float(left.sum() / self._counted.sum())


def _spread(sums: NDArray[np.float64]) -> tuple[FloatArray, FloatArray]:
    """Return Σ w (x − x̄)² and Σ w (x − x̄)(c − c̄) from the sums (5, …) of w, w x, w c, w x² and w x c."""
    w, wx, wc, wxx, wxc = sums
    mean = wx / np.maximum(w, 1e-12)
    return np.maximum(wxx - mean * wx, 0), wxc - mean * wc
