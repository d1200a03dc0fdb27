"""Products of sparse rows with pictures, compiled by Numba on first use and kept for the next start.

Large ones run on all cores; for small ones, waking the other cores would take longer than the product. Cores that wait
for each other sleep: OpenMP's spin, and where other programs are at work they hold up the one that is waited for.
"""

import os
from collections.abc import Callable
from types import FunctionType
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]
F = TypeVar("F", bound=Callable[..., object])
LARGE = 1 << 16  # entries or values

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # read when the first loop starts its threads


def kept(**options: Any) -> Callable[[Any], Any]:
    """Compiled on first use, and kept for the next start where there is a folder to write to.  options : of njit."""

    def jitted(function: Any) -> Any:
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError:  # neither beside its file nor in the user's cache
            return numba.njit(**options)(function)

    return jitted


def compiled(function: F) -> tuple[F, F]:
    """A function whose outer loop is a `numba.prange`, compiled for one core and for all.

    Each under a name of its own, by which Numba keeps what it has compiled: under one, either would be read for both.
    """
    given: Any = function
    alone = FunctionType(given.__code__, given.__globals__, f"{given.__name__}_alone")
    alone.__module__, alone.__qualname__ = given.__module__, alone.__name__
    return kept()(alone), kept(parallel=True)(given)


def product_of_channels(
    indptr: NDArray[np.integer], indices: NDArray[np.integer], weights: FloatArray, source: FloatArray
) -> NDArray[np.float64]:
    """Σ_k weights[k] source[indices[k]] of every row: an index is read once for all channels.

    indptr : (rows + 1,).  indices : (entries,).  weights : (entries, 3).  source : (source pixels, 3).
    Returns (rows, 3), summed in float64.
    """
    return _PRODUCT[indices.size >= LARGE](indptr, indices, weights, source)


def _product(
    indptr: NDArray[np.integer], indices: NDArray[np.integer], weights: FloatArray, source: FloatArray
) -> NDArray[np.float64]:
    result = np.empty((indptr.size - 1, 3))
    for row in numba.prange(indptr.size - 1):
        red, green, blue = 0.0, 0.0, 0.0
        for k in range(indptr[row], indptr[row + 1]):
            at = indices[k]
            red += weights[k, 0] * source[at, 0]
            green += weights[k, 1] * source[at, 1]
            blue += weights[k, 2] * source[at, 2]
        result[row, 0], result[row, 1], result[row, 2] = red, green, blue
    return result


_PRODUCT = compiled(_product)


@kept()
def transpose(
    indptr: NDArray[np.integer], indices: NDArray[np.integer], weights: FloatArray, columns: int
) -> tuple[NDArray[np.int64], NDArray[np.int32], FloatArray]:
    """The transposes as rows: (columns + 1,), (entries,) and (entries, 3); entries of a row as the rows came."""
    starts = np.zeros(columns + 1, np.int64)
    for at in indices:
        starts[at + 1] += 1
    for at in range(columns):
        starts[at + 1] += starts[at]
    place, rows, values = starts[:-1].copy(), np.empty(indices.size, np.int32), np.empty_like(weights)
    for row in range(indptr.size - 1):
        for k in range(indptr[row], indptr[row + 1]):
            to = place[indices[k]]
            rows[to] = row
            for channel in range(3):
                values[to, channel] = weights[k, channel]
            place[indices[k]] += 1
    return starts, rows, values
