"""Connected components of the bipartite graph camera pixels | projector pixels; checks that they are finite."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, IntArray
from counterlight.errors import InputError
from counterlight.maps.products import kept
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import Csr, luminance_matrix


@dataclass(frozen=True)
class Clusters:
    """A label per pixel, −1 for pixels without any connection.

    camera, projector : (pixels,) int64. Labels 0 … count − 1.
    camera_sizes, projector_sizes : (count,). Pixels in each cluster.
    """

    camera: NDArray[np.int64]
    projector: NDArray[np.int64]
    camera_sizes: NDArray[np.int64]
    projector_sizes: NDArray[np.int64]

    @property
    def count(self) -> int:
        return self.projector_sizes.size


def no_clusters(shape: tuple[int, int]) -> Clusters:
    """Return clusters without any labelled pixel. shape : (camera pixels, projector pixels)."""
    camera, projector = (np.full(pixels, -1, np.int64) for pixels in shape)
    return Clusters(camera, projector, np.zeros(0, np.int64), np.zeros(0, np.int64))


def find_clusters(pattern: Csr) -> Clusters:
    """Label the connected components of a (camera pixels, projector pixels) matrix; unconnected pixels get −1.

    Labels increase with the first camera pixel of each component.
    """
    rows, columns = pattern.shape
    label, count = _labels(pattern.indptr, pattern.indices, columns)
    camera, projector = label[:rows], label[rows:]
    sizes = [np.bincount(part[part >= 0], minlength=count).astype(np.int64) for part in (camera, projector)]
    return Clusters(camera, projector, sizes[0], sizes[1])


@kept(nogil=True)
def largest_cluster(camera: IntArray, projector: IntArray, keep: BoolArray, rows: int, columns: int) -> int:
    """Return the largest number of projector pixels that kept connections join; a search calls this about twenty times.

    camera, projector, keep : (connections,).
    rows, columns : number of camera and projector pixels.
    """
    parent, sizes = np.arange(rows + columns), np.zeros(rows, np.int64)
    for k in range(keep.size):
        if keep[k]:
            _join(parent, camera[k], rows + projector[k])
    for column in range(columns):
        root = _root(parent, rows + column)
        if root < rows:  # a camera pixel; an isolated projector pixel is its own root
            sizes[root] += 1
    return sizes.max() if rows else 0


@kept(nogil=True)
def _labels(indptr: IntArray, indices: IntArray, columns: int) -> tuple[IntArray, int]:
    """Return labels of camera, then projector pixels, and their number, by disjoint sets rooted in the first pixel.

    Scipy's function, with float64 links in both directions, takes several times as long.
    """
    rows = indptr.size - 1
    parent = np.arange(rows + columns)
    for row in range(rows):
        for k in range(indptr[row], indptr[row + 1]):
            _join(parent, row, rows + indices[k])
    label, count = np.full(rows + columns, -1), 0
    for pixel in range(rows + columns):
        root = _root(parent, pixel)
        if root != pixel:
            label[pixel] = label[root]
        elif pixel < rows and indptr[pixel] < indptr[pixel + 1]:
            label[pixel] = count
            count += 1
    return label, count


@kept(nogil=True)
def _join(parent: IntArray, pixel: int, other: int) -> None:
    first, second = _root(parent, pixel), _root(parent, other)
    parent[max(first, second)] = min(first, second)


@kept(nogil=True)
def _root(parent: IntArray, pixel: int) -> int:
    while parent[pixel] != pixel:
        parent[pixel] = parent[parent[pixel]]
        pixel = parent[pixel]
    return pixel


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
