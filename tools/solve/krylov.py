"""Least squares of minimum norm without factorisation, for systems too large for dense algebra (LSMR, Fong 2011)."""

import numpy as np
from scipy.sparse.linalg import LinearOperator, lsmr
from threadpoolctl import threadpool_limits

from counterlight.tools.solve.solution import Solution
from counterlight.tools.solve.system import LinearSystem

TOLERANCE = 1e-8
MOST_STEPS = 1000
STOPPED_AT_LIMIT = 7


def least_squares(system: LinearSystem) -> Solution:
    """min ‖T p − b‖, of minimum norm since it starts from 0; its note says how far it got."""
    operator = LinearOperator(system.shape, matvec=system.apply, rmatvec=system.apply_transpose, dtype=np.float64)
    with threadpool_limits(limits=1):  # products of vectors are too small a work for several
        p, reason, steps, residual, gradient, *_ = lsmr(
            operator, system.target, atol=TOLERANCE, btol=TOLERANCE, conlim=0, maxiter=MOST_STEPS
        )
    short = " (its limit: ill-conditioned)" if reason == STOPPED_AT_LIMIT else ""
    return Solution(np.asarray(p), (f"LSMR, {steps} steps{short}, ‖Tᵀr‖ {gradient:.1e}, ‖r‖ {residual:.1e}",))
