"""Some columns of the inverse of a sparse, symmetric and positive definite matrix, by Cholesky.

With the pixels of a window in scan order, the normal equations form a band. Its width is the picture's row length times
the reach of one pixel's light. LAPACK's banded factor is then 1.3 to 7 times faster than the dense one (windows of
24x24 to 64x64 pixels). For a wide band, the dense factor is faster. Pixels of several projectors that light the same
places are far apart in scan order. The order of Cuthill and McKee (1969) brings them together and halves the band.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, solve_triangular
from scipy.linalg.lapack import dpbtrf, dpbtrs, dtrtri
from scipy.sparse.csgraph import reverse_cuthill_mckee

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.transport.transport import Csr

WIDEST_BAND = 1 / 4  # share of the matrix size; a wider band is solved faster as a dense matrix
WORTH_REORDERING = 0.8  # the matrix is reordered if the band's width falls below this share


def columns_of_inverse(N: Csr, wanted: IntArray) -> FloatArray:
    """Return the columns `wanted` (ascending) of N⁻¹, (n, len(wanted)).

    Raises LinAlgError if N is not positive definite.
    """
    row, column = np.repeat(np.arange(N.shape[0]), np.diff(N.indptr)), N.indices
    band = int(np.max(row - column, initial=0))
    place = np.argsort(reverse_cuthill_mckee(N, symmetric_mode=True))
    narrow = int(np.max(place[row] - place[column], initial=0))
    if narrow < WORTH_REORDERING * band and narrow <= WIDEST_BAND * N.shape[0]:
        return _by_band(N, place[row], place[column], narrow, place[wanted])[place]
    if band <= WIDEST_BAND * N.shape[0]:
        return _by_band(N, row, column, band, wanted)
    order = np.append(np.setdiff1d(np.arange(N.shape[0]), wanted, assume_unique=True), wanted)
    dense = np.zeros(N.shape, order="F")
    place = np.argsort(order)
    dense[place[row], place[column]] = N.data
    return last_columns_of_inverse(dense, wanted.size)[place]


def _by_band(N: Csr, row: NDArray[np.integer], column: NDArray[np.integer], band: int, wanted: IntArray) -> FloatArray:
    """Solve by a banded factor. row, column, wanted : places in the banded order."""
    lower = row >= column
    stored = np.zeros((band + 1, N.shape[0]), order="F")
    stored[(row - column)[lower], column[lower]] = N.data[lower]
    factor, refused = dpbtrf(stored, lower=1, overwrite_ab=1)
    if refused:
        raise np.linalg.LinAlgError(f"the leading {refused} rows are not positive definite")
    units = np.zeros((N.shape[0], wanted.size), order="F")
    units[wanted, np.arange(wanted.size)] = 1.0
    return np.asarray(dpbtrs(factor, units, lower=1, overwrite_b=1)[0])


def last_columns_of_inverse(N: NDArray[np.float64], count: int) -> FloatArray:
    """Return the last `count` columns of N⁻¹. N is symmetric and positive definite, (n, n), and is overwritten.

    With N = L Lᵀ, the last columns of L⁻¹ are 0 except for the inverse of L's last block, which halves the work.
    """
    factor = cho_factor(N, lower=True, overwrite_a=True, check_finite=False)[0]
    split = len(N) - count
    X = np.zeros((len(N), count), order="F")
    X[split:] = np.tril(dtrtri(factor[split:, split:], lower=True)[0])
    return np.asarray(solve_triangular(factor, X, lower=True, trans=1, overwrite_b=True, check_finite=False))
