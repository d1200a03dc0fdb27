"""Non-negative least squares, min ‖T p − b‖, p ≥ 0 (thesis 4.2.4), afterwards clamped to what a projector can show.

Clusters by block principal pivoting (Kim and Park 2011), all of one shape at once: guess which pixels are 0, solve for
the others, exchange all that contradict the conditions of optimality, and, should that cycle, only the last of them.
What does not end, or ends inexactly, goes to scipy's active sets (Lawson and Hanson 1974). Too large clusters by
projected gradient.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from tools.solve.box import projected_gradient
from tools.solve.clusterwise import solve_clusters
from tools.solve.solution import Solution
from tools.solve.system import LinearSystem

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
FULL_EXCHANGES = 3  # without progress, before single ones
MOST_ROUNDS = 100
RIDGE = 1e-14  # of the largest diagonal value: a singular system gets an answer, which refinement then corrects
REFINEMENTS = 2
TOLERANCE = 1e-9  # of ‖T_j‖ ‖b‖, for the conditions of optimality


def solve_nnls(system: LinearSystem) -> Solution:
    """The non-negative optimum, per cluster where there are clusters."""
    return solve_clusters(
        system, _pivoted, "went to Lawson and Hanson's active sets", lambda rest: projected_gradient(rest, np.inf)
    )


def _pivoted(blocks: FloatArray, targets: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Blocks (k, m, n), b (k, m) -> p (k, n), and whether a block went to scipy (k,)."""
    transposed = np.swapaxes(blocks, 1, 2)
    gram = transposed @ blocks
    size = np.linalg.norm(blocks, axis=1) * np.linalg.norm(targets, axis=1)[:, None]
    p, free = _exchange(blocks, gram, targets, TOLERANCE * size)
    dual = (transposed @ (np.einsum("kmn,kn->km", blocks, p) - targets)[..., None])[..., 0]
    wrong = np.where(free, np.abs(dual), -dual) > TOLERANCE * size
    failed = (wrong | (p < 0) | ~np.isfinite(p)).any(axis=1)
    for k in np.flatnonzero(failed):
        p[k] = nnls(blocks[k], targets[k], maxiter=30 * blocks.shape[2])[0]
    return p, failed


def _exchange(
    blocks: FloatArray, gram: FloatArray, targets: FloatArray, slack: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """p and which pixels are free, (k, n) each, after the exchanges; optimal if the loop came to rest."""
    count, n = slack.shape
    free = np.zeros((count, n), bool)
    p = np.zeros((count, n))
    fewest, patience = np.full(count, n + 1), np.full(count, FULL_EXCHANGES)
    todo = np.arange(count)
    for _ in range(MOST_ROUNDS):
        p[todo], dual = _solve_free(blocks[todo], gram[todo], targets[todo], free[todo])
        wrong = np.where(free[todo], p[todo] < 0, dual < -slack[todo])
        contradictions = wrong.sum(axis=1)
        open_ = contradictions > 0
        todo, wrong, contradictions = todo[open_], wrong[open_], contradictions[open_]
        if not todo.size:
            break
        better = contradictions < fewest[todo]
        fewest[todo] = np.minimum(fewest[todo], contradictions)
        patience[todo] = np.where(better, FULL_EXCHANGES, patience[todo] - 1)
        single = patience[todo] < 0
        last = n - 1 - np.argmax(wrong[:, ::-1], axis=1)
        wrong[single] &= np.arange(n) == last[single, None]
        free[todo] ^= wrong
    return p, free


def _solve_free(
    blocks: FloatArray, gram: FloatArray, targets: FloatArray, free: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """p (k, n), the least squares over the free pixels, and the gradient Tᵀ(T p − b) (k, n)."""
    n = gram.shape[1]
    transposed = np.swapaxes(blocks, 1, 2)
    diagonal = np.einsum("knn->kn", gram)
    largest = np.maximum(diagonal.max(axis=1), np.finfo(float).tiny)
    masked = gram * (free[:, :, None] & free[:, None, :])
    at = np.arange(n)
    masked[:, at, at] = np.where(free, diagonal + RIDGE * largest[:, None], 1.0)
    p = np.zeros(free.shape)
    gradient = -(transposed @ targets[..., None])
    for _ in range(1 + REFINEMENTS):  # corrected normal equations (Björck 1996, 6.6.5): as exact as QR up to 1/√ε
        p -= np.linalg.solve(masked, np.where(free[..., None], gradient, 0.0))[..., 0]
        gradient = transposed @ (blocks @ p[..., None] - targets[..., None])
    return p, gradient[..., 0]
