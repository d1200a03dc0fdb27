"""Certified truncation: drop entries of T⁺ that change no pixel by more than a budget (docs/mathematics.md 2)."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray


def entries_to_keep(products: FloatArray, budget: FloatArray | float) -> NDArray[np.bool_]:
    """Return which entries of each row stay, (rows, columns): the smallest are dropped while their sum fits the budget.

    products : (rows, columns). |T⁺_ij| · u_j, with u_j the largest |c_j − e_j|.
    budget : (rows,) or a scalar. Largest change of a row's result, in drive.

    Equal products are dropped or kept together.
    """
    ascending = np.sort(products, axis=1)
    fit = np.count_nonzero(np.cumsum(ascending, axis=1) <= np.reshape(budget, (-1, 1)), axis=1)
    ascending = np.concatenate([ascending, np.full((len(products), 1), np.inf)], axis=1)
    first_kept = ascending[np.arange(len(products)), fit]
    return np.asarray((products >= first_kept[:, None]) & (products > 0))
