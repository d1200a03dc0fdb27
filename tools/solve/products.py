"""Three colour channels' T as one matrix of shared rows: a product reads every index once, on all cores."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.products import product_of_channels
from counterlight.tools.solve.system import LinearSystem
from counterlight.tools.transport.transport import shared_pattern

FloatArray = NDArray[np.float64]
CHANNELS = 3


class ChannelProducts:
    """T p and Tᵀ c of up to three systems of one shape; missing channels are dark.

    The weights are kept in float32 where that loses nothing, as with every T that comes from a file.
    """

    def __init__(self, systems: Sequence[LinearSystem]) -> None:
        shape = systems[0].shape
        dark = [sparse.csr_array(shape)] * (CHANNELS - len(systems))
        indptr, indices, exact = shared_pattern([system.near for system in systems] + dark, np.float64)
        short = exact.astype(np.float32)
        weights = short if np.array_equal(short, exact) else exact
        self._near = indptr, indices.astype(np.int32), weights
        places = sparse.csr_array((np.arange(indices.size), indices, indptr), shape=shape).T.tocsr()
        self._transposed = places.indptr, places.indices.astype(np.int32), weights[places.data]
        self._far = [(i, system.far) for i, system in enumerate(systems) if system.far is not None]

    def apply(self, p: FloatArray) -> FloatArray:
        """T p: (projector pixels, 3) -> (camera pixels, 3)."""
        seen = product_of_channels(*self._near, p)
        for i, far in self._far:
            seen[:, i] += far.scatter @ (far.mix @ (far.gather @ p[:, i]))
        return seen

    def apply_transpose(self, c: FloatArray) -> FloatArray:
        """Tᵀ c: (camera pixels, 3) -> (projector pixels, 3)."""
        dual = product_of_channels(*self._transposed, c)
        for i, far in self._far:
            dual[:, i] += far.gather.T @ (far.mix.T @ (far.scatter.T @ c[:, i]))
        return dual
