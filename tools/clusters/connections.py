"""The weighted bipartite graph of camera and projector pixels that the decomposition cuts (thesis 4.2.2, Appendix A).

A camera pixel of a dense T has thousands of blocks of a few additions each; numpy would scan the remaining graph again
for every block.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.maps.products import kept
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


def strongest_of_block(
    graph: Connections, order: IntArray, projector_shape: tuple[int, int], radius: float
) -> IntArray:
    """Return the strongest connection of each connection's block.

    order : connections by camera pixel, strongest first.
    projector_shape : (height, width).

    Returns (connections,), indices of connections.
    """
    if radius < 1:
        return np.arange(order.size)
    return np.asarray(_strongest(order, graph.ends, graph.projector, *projector_shape, float(radius)))


@kept()
def _strongest(
    order: NDArray[np.int64],
    ends: NDArray[np.int64],
    projector: NDArray[np.int64],
    height: int,
    width: int,
    radius: float,
) -> NDArray[np.int64]:
    """Paint discs, per camera pixel, around its strongest connections that no disc covers yet.

    ends : (camera pixels,). End of each camera pixel's connections in `order`.
    """
    strongest = np.empty(order.size, np.int64)
    painted_by, middle = np.full((height, width), -1), np.empty((height, width), np.int64)
    reach = int(min(radius, height + width))
    start = 0
    for camera_pixel in range(ends.size):
        for connection in order[start : ends[camera_pixel]]:
            y, x = divmod(projector[connection], width)
            if painted_by[y, x] != camera_pixel:
                for v in range(max(y - reach, 0), min(y + reach + 1, height)):
                    for u in range(max(x - reach, 0), min(x + reach + 1, width)):
                        inside = (v - y) ** 2 + (u - x) ** 2 <= radius * radius
                        if inside and painted_by[v, u] != camera_pixel:
                            painted_by[v, u], middle[v, u] = camera_pixel, connection
            strongest[connection] = middle[y, x]
        start = ends[camera_pixel]
    return strongest


def fit_composition(graph: Connections, keep: BoolArray) -> NDArray[np.float32]:
    """Rescale each camera pixel's kept connections to preserve its composition: Σ_j T'_kj = Σ_j T_kj.

    Each channel has its own factor (Σ_j T_kj) / (Σ_j kept T_kj). If no kept connection carries a channel, no factor can
    restore it; its light is then distributed over the kept connections by luminance.

    Returns (kept connections, 3).
    """
    camera, luminance = graph.camera[keep], graph.luminance[keep]
    share = luminance / _sums(camera, luminance, graph.shape[0])[camera]
    fitted = np.empty((camera.size, graph.weights.shape[1]), np.float32)
    for i in range(fitted.shape[1]):
        before = _sums(graph.camera, graph.weights[:, i], graph.shape[0])[camera]
        weights = graph.weights[keep, i].astype(np.float64)
        after = _sums(camera, weights, graph.shape[0])[camera]
        scaled = weights * np.divide(before, after, out=np.zeros_like(before), where=after > 0)
        fitted[:, i] = np.where(after > 0, scaled, before * share)
    return fitted


def _sums(camera: NDArray[np.int64], weights: NDArray[np.floating], camera_pixels: int) -> FloatArray:
    return np.bincount(camera, weights=weights, minlength=camera_pixels).astype(np.float64)  # empty sums are integers
