"""Refuses transports and targets that are not finite, naming the cluster that holds the bad number."""

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.maps.row_map import SparseRows
from counterlight.tools.clusters.components import Clusters, find_clusters
from counterlight.tools.transport.transport import luminance_matrix

FLOAT32 = np.finfo(np.float32)  # the stored type of T and pictures; squares of float32 numbers fit float64
CAUSES = "likely causes: a division by a black floodlight picture, a saturated capture, or another unit of radiance"


class NonFiniteError(InputError):
    """T or b holds NaN or infinity, numbers beyond float32, or numbers that make a solver overflow."""


def refuse_not_finite(near: SparseRows, target: NDArray[np.float64]) -> None:
    """Raise NonFiniteError with the first cluster in which T or b is not finite, or beyond float32.

    near : T, (camera pixels, projector pixels).
    target : b, (camera pixels, 3).
    """
    size = np.abs(near.weights)
    seen = (size == 0) | (np.fmax.reduce(size, axis=0, initial=0.0) >= FLOAT32.smallest_subnormal)
    usable = ((size <= FLOAT32.max) & seen).all(axis=1)
    bad = np.flatnonzero(~(np.abs(target) <= FLOAT32.max).all(axis=1))
    if not usable.all():
        bad = np.union1d(near.rows[~usable], bad)
    if not bad.size:
        return
    clusters = find_clusters(luminance_matrix(near))
    label = clusters.camera[bad[0]]
    cluster = "no cluster" if label < 0 else describe_cluster(clusters, int(label))
    raise NonFiniteError(
        f"T or b is not finite, or beyond float32, in {bad.size} of {near.shape[0]} camera pixels, first camera pixel "
        f"{bad[0]} ({cluster}); {CAUSES}"
    )


def describe_cluster(clusters: Clusters, label: int) -> str:
    """Describe a cluster by number, sizes and first camera pixel."""
    first = int(np.argmax(clusters.camera == label))
    m, n = clusters.camera_sizes[label], clusters.projector_sizes[label]
    return f"cluster {label} of {clusters.count}, {m} camera x {n} projector pixels from camera pixel {first} on"
