"""Products of sparse rows with pictures, compiled by Numba on first use and cached for the next start.

Large products run on all cores; for small ones, waking other cores would take longer than the product. Waiting cores
sleep. OpenMP's default is to spin, and spinning threads slow the awaited core when other programs run.
"""

import os
from collections.abc import Callable
from contextlib import suppress
from types import FunctionType
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]
F = TypeVar("F", bound=Callable[..., object])
LARGE = 1 << 16  # number of entries or values from which all cores share the work


os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # read when the first parallel loop starts its threads


class QuickCache(FunctionCache):
    """Cache of a function's compiled code that loads without preparing to compile, which takes Numba 0.4 s."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled code for a signature, or None. Numba prepares later, before it compiles."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]


def kept(**options: Any) -> Callable[[Any], Any]:
    """Decorator: compile on first use, and cache for the next start if a writable folder exists. options : of njit."""

    def jitted(function: Any) -> Any:
        made: Any = numba.njit(**options)(function)
        with suppress(RuntimeError):  # neither the file's folder nor the user's cache is writable
            made._cache = QuickCache(function)  # type: ignore[no-untyped-call]
        return made

    return jitted


def compiled(function: F) -> tuple[F, F]:
    """Compile a function with an outer `numba.prange` loop, for one core and for all cores.

    Each version needs its own name: Numba caches by name, and would load either version for both.
    """
    given: Any = function
    alone = FunctionType(given.__code__, given.__globals__, f"{given.__name__}_alone")
    alone.__module__, alone.__qualname__ = given.__module__, alone.__name__
    return kept()(alone), kept(parallel=True)(given)


def product_of_channels(
    indptr: NDArray[np.integer], indices: NDArray[np.integer], weights: FloatArray, source: FloatArray
) -> NDArray[np.float64]:
    """Return Σ_k weights[k] source[indices[k]] of every row; each index is read once for all channels.

    indptr : (rows + 1,).
    indices : (entries,).
    weights : (entries, 3).
    source : (source pixels, 3).

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
    """Return the transposes as rows: (columns + 1,), (entries,), (entries, 3). Each row's entries keep their order."""
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


@kept(parallel=True, error_model="numpy")
def unpack_entries(
    lookup: NDArray[np.uint32],
    entries: NDArray[np.float32],
    index: NDArray[np.uint32],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
    weights: NDArray[np.float32],
) -> None:
    """Fill the indices and weights of every row.

    lookup : (rows, 3). Column and line of a row's first texel, and its length.
    entries : (lines, width, 4). Three weights, and the source pixel where `index` is empty.
    index : (lines, width), or (0, 0). The source pixel.
    indptr : (rows + 1,). Where each row begins among all entries.
    """
    for row in numba.prange(lookup.shape[0]):
        x, y, first = lookup[row, 0], lookup[row, 1], indptr[row]
        for k in range(indptr[row + 1] - first):
            texel = entries[y, x + k]
            for channel in range(3):
                weights[first + k, channel] = texel[channel]
            indices[first + k] = index[y, x + k] if index.size else np.int32(texel[3])
