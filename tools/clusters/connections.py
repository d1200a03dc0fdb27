"""The weighted bipartite graph of camera and projector pixels that the decomposition cuts (thesis 4.2.2)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.colour import LUMINANCE
from counterlight.errors import InputError
from counterlight.tools.transport.transport import CHANNELS, Csr, shared_pattern

BoolArray = NDArray[np.bool_]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Connections:
    """Every pair of a camera and a projector pixel that any channel connects, by camera, then by projector pixel.

    camera, projector : (connections,) pixel indices.  weights : (connections, 3) float32, radiance per unit drive.
    luminance : (connections,) float64 > 0.  shape : (camera pixels, projector pixels).
    """

    camera: IntArray
    projector: IntArray
    weights: NDArray[np.float32]
    luminance: FloatArray
    shape: tuple[int, int]

    def pattern(self, keep: BoolArray) -> Csr:
        """The kept connections as a matrix of ones."""
        projector = self.projector[keep]
        return sparse.csr_array((np.ones(projector.size, np.int8), projector, self._indptr(keep)), shape=self.shape)

    def matrices(self, keep: BoolArray, weights: NDArray[np.float32]) -> tuple[Csr, ...]:
        """The kept connections with new weights (kept, 3), a matrix per channel; a channel's own zeros are stored."""
        projector, indptr = self.projector[keep], self._indptr(keep)
        return tuple(
            sparse.csr_array((weights[:, i].copy(), projector.copy(), indptr.copy()), shape=self.shape)
            for i in range(len(CHANNELS))
        )

    def _indptr(self, keep: BoolArray) -> IntArray:
        lengths = np.bincount(self.camera[keep], minlength=self.shape[0])
        return np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)


def connections_of(
    matrices: tuple[Csr, ...], camera_shape: tuple[int, int], projector_shape: tuple[int, int]
) -> Connections:
    """The graph of T for red, green and blue, each (camera pixels, projector pixels) without duplicates.

    camera_shape, projector_shape : (height, width).
    Raises InputError if a matrix has another size, or entries that are negative or not finite.
    """
    shape = camera_shape[0] * camera_shape[1], projector_shape[0] * projector_shape[1]
    for name, matrix in zip(CHANNELS, matrices, strict=True):
        _check(name, matrix, shape)
    indptr, projector, weights = shared_pattern(matrices)
    camera = np.repeat(np.arange(shape[0]), np.diff(indptr))
    # Term by term: a matrix product rounds by an entry's place, and equal weights must stay equal.
    red, green, blue = (LUMINANCE[i] * weights[:, i].astype(np.float64) for i in range(3))
    luminance = red + green + blue
    lit = luminance > 0
    if not lit.all():
        camera, projector, weights, luminance = camera[lit], projector[lit], weights[lit], luminance[lit]
    return Connections(camera, projector, weights, luminance, shape)


def _check(name: str, matrix: Csr, shape: tuple[int, int]) -> None:
    if matrix.shape != shape:
        raise InputError(
            f"transport_{name}: {matrix.shape[0]}x{matrix.shape[1]} entries, expected {shape[0]} camera pixels x "
            f"{shape[1]} projector pixels; check the sizes in calibration.toml"
        )
    bad = int(np.count_nonzero(~((matrix.data >= 0) & np.isfinite(matrix.data))))
    if bad:
        raise InputError(
            f"transport_{name}: {bad} of {matrix.nnz} entries are negative, NaN or infinite, expected radiance ≥ 0; "
            "import the measurement again with: counterlight import-transport"
        )
