"""Non-negative least squares, min ‖T p − b‖, p ≥ 0 (thesis 4.2.4), afterwards clamped to what a projector can show.

Clusters by block principal pivoting (Kim and Park 2011), compiled by Numba: guess which pixels are 0, solve for
the others, exchange all that contradict the conditions of optimality, and, should that cycle, only the last of them.
What does not end, or ends inexactly, goes to scipy's active sets (Lawson and Hanson 1974). Too large clusters by
projected gradient.
"""

from functools import partial

import numpy as np
from scipy import optimize

from counterlight.arrays import BoolArray, FloatArray
from counterlight.maps.products import kept
from counterlight.tools.solve.box import Box
from counterlight.tools.solve.channel import Channel
from counterlight.tools.solve.clusterwise import Clusterwise

FULL_EXCHANGES = 3  # without progress, before single ones
MOST_ROUNDS = 100
RIDGE = 1e-14  # of the largest diagonal value: a singular system gets an answer, which refinement then corrects
REFINEMENTS = 2
TINY = np.finfo(float).tiny
EXACT = 0.01  # of the slack below: no refinement is needed
TOLERANCE = 1e-9  # of ‖T_j‖ ‖b‖, for the conditions of optimality


def nnls(T: Channel) -> Clusterwise:
    """The non-negative optimum, per cluster where there are clusters."""
    return Clusterwise(
        T, lambda blocks: partial(_pivoted, blocks), "went to Lawson and Hanson's active sets", _ByProjectedGradient
    )


class _ByProjectedGradient:
    def __init__(self, T: Channel) -> None:
        self._box = Box(T.alone(), np.inf)

    def solve(self, b: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        p, notes = self._box.run(np.stack([b, 0 * b, 0 * b], axis=1))
        return p[:, 0], notes[:1]


def _pivoted(blocks: FloatArray, targets: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Blocks (k, m, n), b (k, m) -> p (k, n), and whether a block went to scipy (k,)."""
    size = np.linalg.norm(blocks, axis=1) * np.linalg.norm(targets, axis=1)[:, None]
    p, free = _exchange(blocks, targets, TOLERANCE * size)
    seen = (blocks @ p[..., None])[..., 0]
    dual = (np.swapaxes(blocks, 1, 2) @ (seen - targets)[..., None])[..., 0]
    wrong = np.where(free, np.abs(dual), -dual) > TOLERANCE * size
    failed = (wrong | (p < 0) | ~np.isfinite(p)).any(axis=1)
    for k in np.flatnonzero(failed):
        p[k] = optimize.nnls(blocks[k], targets[k], maxiter=30 * blocks.shape[2])[0]
    return p, failed


@kept(nogil=True)
def _exchange(blocks: FloatArray, targets: FloatArray, slack: FloatArray) -> tuple[FloatArray, BoolArray]:
    """p and which pixels are free, (k, n) each, after the exchanges; optimal if they came to rest."""
    count, n = slack.shape
    p, free = np.zeros((count, n)), np.zeros((count, n), np.bool_)
    for k in range(count):
        gram, product = blocks[k].T @ blocks[k], blocks[k].T @ targets[k]
        fewest, patience = n + 1, FULL_EXCHANGES
        for _ in range(MOST_ROUNDS):
            p[k] = _solve_free(gram, product, free[k])
            dual = gram @ p[k] - product
            wrong = np.flatnonzero(np.where(free[k], p[k] < 0, dual < -slack[k]))
            if not wrong.size:
                break
            if wrong.size < fewest:
                fewest, patience = wrong.size, FULL_EXCHANGES
            else:
                patience -= 1
            for j in wrong if patience >= 0 else wrong[-1:]:
                free[k, j] = not free[k, j]
        for _ in range(REFINEMENTS):  # corrected normal equations (Björck 1996, 6.6.5): as exact as QR up to 1/√ε
            descent = blocks[k].T @ (targets[k] - blocks[k] @ p[k])
            if not (free[k] & (np.abs(descent) > EXACT * slack[k])).any():
                break
            p[k] += _solve_free(gram, descent, free[k])
    return p, free


@kept(nogil=True)
def _solve_free(gram: FloatArray, product: FloatArray, free: BoolArray) -> FloatArray:
    """p (n,) with TᵀT p = `product` on the free pixels, 0 on the others."""
    at, p = np.flatnonzero(free), np.zeros(free.size)
    if at.size == 0:
        return p
    normal = np.empty((at.size, at.size))
    for i in range(at.size):
        for j in range(at.size):
            normal[i, j] = gram[at[i], at[j]]
    ridge = RIDGE * max(np.diag(gram).max(), TINY)
    for i in range(at.size):
        normal[i, i] += ridge
    p[at] = np.linalg.solve(normal, product[at])
    return p
