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
UNSURE = 0.15  # standard deviation of a part's g by the error model; in the rig, parts deviate by a ninth of it
AGREED = 0.03  # largest distance of a part's g from the mean of all parts
CLEAR, FAINT = 0.05, 0.015  # distances of g from 1: of a square of SQUARE blocks, and of blocks connected with it
SQUARE = np.ones((3, 3), np.bool_)  # thin lines are edges that a camera sees elsewhere, not changes of the wall
KNOWN = 0.5  # least share of the blocks whose g is known
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
        differs = np.any(np.abs(found - present) > FAINT, axis=1)
        xx, xc = (each.sum(axis=0) for each in _spread(self._sums[1:, 1].swapaxes(0, 1)))
        better = np.sum(xc * (found - present) - 0.5 * xx * (found**2 - present**2), axis=1)
        label = ndimage.label(differs.reshape(self._shape), SQUARE)[0].ravel()
        worth = (np.bincount(label, better) > WORTH)[label] & differs
        self.learned = Learned(np.where(worth[:, None], found, present), beyond)

    def _found(self, present: FloatArray) -> tuple[FloatArray, float]:
        """Return g by the fitted comparisons, (blocks, 3), and `Learned.beyond`. An unknown g keeps its value."""
        xx, xc = _spread(self._sums[1:, 0].swapaxes(0, 1))
        parts, g = xc / np.maximum(xx, 1e-12), xc.sum(axis=0) / np.maximum(xx.sum(axis=0), 1e-12)
        known = np.all(xx > UNSURE**-2, axis=0) & (np.abs(parts - g).max(axis=0) < AGREED) & self._counted[:, None]
        if known.sum() < KNOWN * 3 * self._counted.sum():
            return present, self.learned.beyond
        g /= [np.median(g[known[:, k], k]) if known[:, k].any() else 1.0 for k in range(3)]  # the lamp's part
        region, left = self._regions(np.where(known, g, 1))
        found = np.where(known, np.where(region[:, None], np.clip(g, *ROW_GAINS), 1), present)
        found = np.where(region[:, None] & ~known, self._nearest(found, known), found)
        return np.where(left[:, None], present, found), float(left.sum() / self._counted.sum())

    def _regions(self, g: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Return the blocks that have changed, and the blocks of regions beyond the limits: (blocks,) bool each."""
        away = np.abs(g - 1).max(axis=1).reshape(self._shape)
        core = ndimage.binary_opening(away > CLEAR, SQUARE)
        region = ndimage.binary_fill_holes(ndimage.binary_propagation(core, SQUARE, away > FAINT))
        label = ndimage.label(region, SQUARE)[0].ravel()
        out = np.any((g < ROW_GAINS[0]) | (g > ROW_GAINS[1]), axis=1)
        left = (np.bincount(label, out) > BEYOND * np.bincount(label))[label] & (label > 0)
        return (label > 0) & ~left, left

    def _nearest(self, g: FloatArray, known: BoolArray) -> FloatArray:
        """Return g of the nearest known block, channel by channel, for blocks that the film does not determine."""
        grids = [each.reshape(self._shape) for each in known.T]
        places = (ndimage.distance_transform_edt(~each, return_distances=False, return_indices=True) for each in grids)
        values = zip(g.T, places, strict=True)
        return np.stack([each.reshape(self._shape)[tuple(place)].ravel() for each, place in values], axis=1)


def _spread(sums: NDArray[np.float64]) -> tuple[FloatArray, FloatArray]:
    """Return Σ w (x − x̄)² and Σ w (x − x̄)(c − c̄) from the sums (5, …) of w, w x, w c, w x² and w x c."""
    w, wx, wc, wxx, wxc = sums
    mean = wx / np.maximum(w, 1e-12)
    return np.maximum(wxx - mean * wx, 0), wxc - mean * wc
