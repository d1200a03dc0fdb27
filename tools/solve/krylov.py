"""Least squares of minimum norm without factorisation, for systems too large for dense algebra (LSMR, Fong 2011)."""

import numpy as np
from scipy.sparse.linalg import lsmr
from threadpoolctl import threadpool_limits

from counterlight.arrays import FloatArray
from counterlight.tools.solve.channel import Channel

TOLERANCE = 1e-8
MOST_STEPS = 1000
STOPPED_AT_LIMIT = 7


class LeastSquares:
    """min ‖T p − b‖, of minimum norm because it starts from 0; its note states steps and residual."""

    def __init__(self, T: Channel) -> None:
        self._operator = T.operator

    def solve(self, b: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        with threadpool_limits(limits=1):  # products of vectors are too small for several threads
            p, reason, steps, residual, gradient, *_ = lsmr(
                self._operator, b, atol=TOLERANCE, btol=TOLERANCE, conlim=0, maxiter=MOST_STEPS
            )
        short = " (its limit: ill-conditioned)" if reason == STOPPED_AT_LIMIT else ""
        return np.asarray(p), (f"LSMR, {steps} steps{short}, ‖Tᵀr‖ {gradient:.1e}, ‖r‖ {residual:.1e}",)
