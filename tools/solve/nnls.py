"""Non-negative least squares, min ‖T p − b‖, p ≥ 0 (thesis 4.2.4), then clamped to what a projector can show.

Clusters use block principal pivoting (Kim and Park 2011), compiled by Numba. The method guesses which pixels are 0,
solves for the others, and exchanges all pixels that violate the optimality conditions. If this cycles, it exchanges
only the last of them. Scipy's active sets (Lawson and Hanson 1974) solve blocks that do not converge, or converge
inexactly. Clusters that are too large use projected gradient.
"""

from functools import partial

import numpy as np
from scipy import optimize

from counterlight.arrays import BoolArray, FloatArray
from counterlight.maps.products import kept
from counterlight.tools.solve.box import Box
from counterlight.tools.solve.channel import Channel
from counterlight.tools.solve.clusterwise import Clusterwise

FULL_EXCHANGES = 3  # full exchanges without progress, before single exchanges
MOST_ROUNDS = 100
RIDGE = (
    1e-14  # share of the largest diagonal value; makes singular systems solvable, and refinement corrects the result
)
REFINEMENTS = 2
TINY = np.finfo(float).tiny
EXACT = 0.01  # share of TOLERANCE; results with smaller errors need no further refinement
TOLERANCE = 1e-9  # relative to ‖T_j‖ ‖b‖, for the optimality conditions


def nnls(T: Channel) -> Clusterwise:
    """Return the solver for the non-negative optimum, per cluster if T has clusters."""
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
    """Solve blocks (k, m, n) for b (k, m): returns p (k, n), and whether a block was solved by scipy, (k,)."""
    size = np.linalg.norm(blocks, axis=1) * np.linalg.norm(targets, axis=1)[:, None]
    adjoint = np.swapaxes(blocks, 1, 2)
    product = (adjoint @ targets[..., None])[..., 0]
    p, free = _exchange(blocks, targets, adjoint @ blocks, product, TOLERANCE * size)
    seen = (blocks @ p[..., None])[..., 0]
    dual = (adjoint @ (seen - targets)[..., None])[..., 0]
    wrong = np.where(free, np.abs(dual), -dual) > TOLERANCE * size
    failed = (wrong | (p < 0) | ~np.isfinite(p)).any(axis=1)
    for k in np.flatnonzero(failed):
        p[k] = optimize.nnls(blocks[k], targets[k], maxiter=30 * blocks.shape[2])[0]
    return p, failed


# Explicit loops instead of numpy's array functions and LAPACK: Numba takes 13 s to compile those, 2 s for loops.


@kept(nogil=True)
def _exchange(
    blocks: FloatArray, targets: FloatArray, gram: FloatArray, product: FloatArray, slack: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return p and the free pixels, (k, n) each, after the exchanges; optimal if they converged.

    gram : TᵀT, (k, n, n).
    product : Tᵀb, (k, n).
    """
    count, n = slack.shape
    p, free = np.zeros((count, n)), np.zeros((count, n), np.bool_)
    wrong, descent, change = np.zeros(n, np.bool_), np.zeros(n), np.zeros(n)
    for k in range(count):
        fewest, patience = n + 1, FULL_EXCHANGES
        for _ in range(MOST_ROUNDS):
            _solve_free(gram[k], product[k], free[k], p[k])
            number, last = _mark_wrong(gram[k], product[k], slack[k], free[k], p[k], wrong)
            if number == 0:
                break
            if number < fewest:
                fewest, patience = number, FULL_EXCHANGES
            else:
                patience -= 1
            for j in range(n):
                if wrong[j] and (patience >= 0 or j == last):
                    free[k, j] = not free[k, j]
        for _ in range(REFINEMENTS):  # corrected normal equations (Björck 1996, 6.6.5): as exact as QR up to 1/√ε
            _descend(blocks[k], targets[k], p[k], descent)
            exact = True
            for j in range(n):
                exact &= not free[k, j] or abs(descent[j]) <= EXACT * slack[k, j]
            if exact:
                break
            _solve_free(gram[k], descent, free[k], change)
            for j in range(n):
                p[k, j] += change[j]
    return p, free


@kept(nogil=True)
def _mark_wrong(
    gram: FloatArray, product: FloatArray, slack: FloatArray, free: BoolArray, p: FloatArray, wrong: BoolArray
) -> tuple[int, int]:
    """Mark the pixels that violate the optimality conditions in `wrong`; returns their number, and the last one."""
    number, last = 0, -1
    for i in range(p.size):
        dual = -product[i]
        for j in range(p.size):
            dual += gram[i, j] * p[j]
        wrong[i] = p[i] < 0 if free[i] else dual < -slack[i]
        if wrong[i]:
            number, last = number + 1, i
    return number, last


@kept(nogil=True)
def _descend(block: FloatArray, target: FloatArray, p: FloatArray, descent: FloatArray) -> None:
    """Compute Tᵀ (b − T p) into `descent`."""
    descent[:] = 0.0
    for i in range(block.shape[0]):
        rest = target[i]
        for j in range(p.size):
            rest -= block[i, j] * p[j]
        for j in range(p.size):
            descent[j] += block[i, j] * rest


@kept(nogil=True)
def _solve_free(gram: FloatArray, product: FloatArray, free: BoolArray, p: FloatArray) -> None:
    """Solve TᵀT p = `product` for the free pixels of p (n,); the others become 0."""
    at, count, largest = np.empty(free.size, np.int64), 0, TINY
    for j in range(free.size):
        p[j] = 0.0
        if free[j]:
            at[count], count, largest = j, count + 1, max(largest, gram[j, j])
    if count == 0:
        return
    normal, right = np.empty((count, count)), np.empty(count)
    for i in range(count):
        right[i] = product[at[i]]
        for j in range(count):
            normal[i, j] = gram[at[i], at[j]]
        normal[i, i] += RIDGE * largest
    _solve_symmetric(normal, right)
    for i in range(count):
        p[at[i]] = right[i]


@kept(nogil=True, error_model="numpy")
def _solve_symmetric(A: FloatArray, b: FloatArray) -> None:
    """Replace b (n,) by A⁻¹ b for positive definite A: L D Lᵀ in the upper half of A (Golub and Van Loan 2013, 4.1)."""
    n = b.size
    for j in range(n):
        for k in range(j):
            factor = A[k, j] / A[k, k]
            for i in range(j, n):
                A[j, i] -= factor * A[k, i]
            b[j] -= factor * b[k]
    for j in range(n - 1, -1, -1):
        rest = b[j]
        for i in range(j + 1, n):
            rest -= A[j, i] * b[i]
        b[j] = rest / A[j, j]
