"""The weighted bipartite graph of camera and projector pixels that the decomposition cuts (thesis 4.2.2)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import CHANNELS, Csr, luminance


@dataclass(frozen=True)
class Connections:
    """Every pair of camera and projector pixel that any channel connects, sorted by camera, then projector pixel.

    camera, projector : (connections,). Pixel indices.
    weights : (connections, 3) float32. Radiance per unit drive.
    luminance : (connections,) float64, > 0.
    shape : (camera pixels, projector pixels).
    """

    camera: IntArray
    projector: IntArray
    weights: NDArray[np.float32]
    luminance: FloatArray
    shape: tuple[int, int]

    @cached_property
    def ends(self) -> IntArray:
        """The end of each camera pixel's connections, (camera pixels,)."""
        return np.cumsum(np.bincount(self.camera, minlength=self.shape[0]))

    def pattern(self, keep: BoolArray) -> Csr:
        """Return the kept connections as a matrix of ones."""
        projector = self.projector[keep]
        return sparse.csr_array((np.ones(projector.size, np.int8), projector, self._indptr(keep)), shape=self.shape)

    def rows(self, keep: BoolArray, weights: NDArray[np.float32]) -> SparseRows:
        """Return the kept connections with new weights, (kept, 3)."""
        return SparseRows(self._indptr(keep), self.projector[keep], weights, self.shape[1])

    def _indptr(self, keep: BoolArray) -> IntArray:
        lengths = np.bincount(self.camera[keep], minlength=self.shape[0])
        return np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)


def connections_of(near: SparseRows, camera_shape: tuple[int, int], projector_shape: tuple[int, int]) -> Connections:
    """Return the graph of T, (camera pixels, projector pixels) without duplicates.

    camera_shape, projector_shape : (height, width).

    Raises InputError if T has another size, or entries that are negative or not finite.
    """
    shape = camera_shape[0] * camera_shape[1], projector_shape[0] * projector_shape[1]
    if near.shape != shape:
        raise InputError(
            f"transport: {near.shape[0]}x{near.shape[1]} entries, expected {shape[0]} camera pixels x {shape[1]} "
            "projector pixels; check the sizes in calibration.toml"
        )
    for name, weights in zip(CHANNELS, near.weights.T, strict=True):
        _check(name, weights)
    light = luminance(near.weights)
    lit = near.where(light > 0)
    weights = lit.weights.astype(np.float32, copy=False)
    return Connections(lit.rows, lit.indices.astype(np.int64), weights, light[light > 0], shape)


def _check(name: str, weights: NDArray[np.floating]) -> None:
    bad = int(np.count_nonzero(~((weights >= 0) & np.isfinite(weights))))
    if bad:
        raise InputError(
            f"transport_{name}: {bad} of {np.count_nonzero(weights)} entries are negative, NaN or infinite, expected "
            "radiance ≥ 0; import the measurement again with: counterlight import-transport"
        )
