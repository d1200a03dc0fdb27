"""Certified truncation: leave out entries of T⁺ that change no pixel by more than a budget (docs/mathematics.md 2)."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def entries_to_keep(products: FloatArray, budget: float) -> tuple[NDArray[np.bool_], FloatArray]:
    """Which entries of each row stay, and the largest change that leaving out the others can make.

    products : (rows, columns) of |T⁺_ij| · u_j, u_j the largest |c_j − e_j|; the smallest are dropped first.
    budget : largest change of a row's result, in drive.
    Returns keep (rows, columns) and dropped (rows,) = Σ of the products left out, ≤ budget.
    """
    order = np.argsort(products, axis=1)
    running = np.cumsum(np.take_along_axis(products, order, axis=1), axis=1)
    drop_sorted = running <= budget
    keep = np.empty(products.shape, bool)
    np.put_along_axis(keep, order, ~drop_sorted, axis=1)
    dropped = np.max(np.where(drop_sorted, running, 0.0), axis=1, initial=0.0)
    return keep & (products > 0), dropped
