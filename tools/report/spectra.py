"""Condition numbers and rank deficits of the inverted systems: whole small clusters, and samples of windows."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import svdvals

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.clusters.components import Clusters
from counterlight.tools.inverse.method import LARGEST_DENSE
from counterlight.tools.inverse.windows import BLOCKS, Windows
from counterlight.tools.transport.transport import Csr

LARGEST_SVD = 400  # pixels per side of a cluster; an SVD of a larger cluster takes seconds
MOST_CLUSTERS = 300
MOST_WINDOWS = 6
WIDEST_HALO = 8  # halo of a sampled window: 32×32 projector pixels, an SVD of a second
FLOAT32_EPS = float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class Spectrum:
    """One inverted system.

    condition : σ₁/σ_r, with σ_r the smallest singular value that counts as non-zero.
    rank_deficit : min(camera, projector pixels) minus the rank. Singular values up to σ₁ · max(m, n) · ε of float32,
        the precision of the stored T, count as zero.
    """

    kind: str
    camera_pixels: int
    projector_pixels: int
    condition: float
    rank_deficit: int

    def to_json(self) -> dict[str, Any]:
        return dict(vars(self))


def spectra(T: Csr, clusters: Clusters, projector_shape: tuple[int, int]) -> list[Spectrum]:
    """Returns the spectra of a fixed sample of the systems, from the luminance of T.

    The sample holds up to 300 whole clusters of at most 400 pixels per side, evenly spaced from the smallest to the
    largest. It also holds up to 6 windows of 32×32 projector pixels of the largest cluster that is inverted through
    windows. Clusters between the two sizes are skipped.

    T : (camera pixels, projector pixels). Rows outside the mask are empty.
    """
    if not clusters.count:
        return []
    columns = sparse.csc_array(T.astype(np.float64))
    entries = np.diff(columns.indptr) * (clusters.projector >= 0)
    seen = np.bincount(np.maximum(clusters.projector, 0), entries, clusters.count) > 0  # T has no rows outside the mask
    small = np.flatnonzero(seen & (clusters.projector_sizes <= LARGEST_SVD) & (clusters.camera_sizes <= LARGEST_SVD))
    small = small[np.argsort(clusters.projector_sizes[small], kind="stable")]
    found = [
        _spectrum("cluster", columns, np.flatnonzero(clusters.projector == label))
        for label in _evenly(small, MOST_CLUSTERS)
    ]
    largest = int(np.argmax(clusters.projector_sizes))
    if clusters.projector_sizes[largest] > LARGEST_DENSE:
        windows = Windows((clusters.projector == largest).reshape(projector_shape), WIDEST_HALO, BLOCKS[0])
        corners = np.array(windows.blocks(), np.int64)
        for y, x in _evenly(corners, MOST_WINDOWS):
            found.append(_spectrum("window", columns, windows.pixels((int(y), int(x)), WIDEST_HALO)))
    return found


def summary(found: list[Spectrum]) -> dict[str, Any]:
    """Returns the page's summary: the number of systems of each kind, and their extremes."""
    return {
        kind: {
            "systems": len(of_kind),
            "condition_median": float(np.median([s.condition for s in of_kind])),
            "condition_largest": max(s.condition for s in of_kind),
            "rank_deficient": sum(s.rank_deficit > 0 for s in of_kind),
            "largest_rank_deficit": max(s.rank_deficit for s in of_kind),
        }
        for kind in ("cluster", "window")
        if (of_kind := [s for s in found if s.kind == kind])
    } | {
        "cluster_side_limit": LARGEST_SVD,
        "window_side": BLOCKS[0] + 2 * WIDEST_HALO,
    }


def _evenly(items: IntArray, most: int) -> IntArray:
    if len(items) <= most:
        return items
    return np.asarray(items[np.linspace(0, len(items) - 1, most).astype(int)])


def _spectrum(kind: str, columns: sparse.csc_array, projector_pixels: IntArray) -> Spectrum:
    local = columns[:, projector_pixels]
    camera, place = np.unique(local.indices, return_inverse=True)
    shape = camera.size, projector_pixels.size
    block = sparse.csc_array((local.data, place, local.indptr), shape=shape).toarray()
    sigma: FloatArray = svdvals(block, check_finite=False)
    kept = sigma[sigma > sigma[0] * max(shape) * FLOAT32_EPS]
    return Spectrum(kind, *shape, float(kept[0] / kept[-1]), int(sigma.size - kept.size))
