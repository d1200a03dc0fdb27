"""T⁺ of a whole room: clusters found, λ chosen, each part inverted, truncated and joined (thesis 4.2.1, 5.1)."""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from threadpoolctl import threadpool_limits

from player.command import track
from player.errors import InputError
from player.row_map import SparseRows
from tools.clusters.components import Clusters, find_clusters
from tools.clusters.decomposition import Parameters, Report
from tools.clusters.search import decompose_to
from tools.inverse.clustered import clustered_jobs, damped_inverse
from tools.inverse.damping import choose_damping, largest_singular_value
from tools.inverse.pieces import Piece, join
from tools.inverse.windowed import WindowedChannel, Windows, choose_halo, windowed_jobs
from tools.transport.mask import LUMINANCE
from tools.transport.transport import Csr, shared_pattern

FloatArray = NDArray[np.float64]
# Projector pixels of a cluster that is inverted whole. Damped, windows are faster beyond (2475 pixels: 33 s whole, 7 s
# in windows); undamped, there are no windows, and a block of the limit costs minutes.
LARGEST_DENSE, LARGEST_PLAIN = 1000, 4000
LARGEST_BLOCK = (
    1 << 24
)  # camera times projector pixels of a cluster inverted whole: 128 MiB, about ten times that at work
FINEST_TOLERANCE = 0.05 / 255  # drive; windows are not widened for less


@dataclass(frozen=True)
class InverseOptions:
    """How to invert.

    damping : λ as a fraction of each channel's largest singular value, 0 for the plain pseudo-inverse, None to choose.
    max_error : certified change of a pixel by truncation, in 8-bit code values of linear drive; 0 keeps everything.
    noise : relative noise of T's entries; the plain pseudo-inverse leaves out singular values that it alone would have.
    max_cluster : decompose T into clusters of at most so many projector pixels (thesis 4.2.2); None leaves it whole.
    """

    damping: float | None = None
    max_error: float = 0.5
    max_cluster: int | None = None
    noise: float = 0.0

    def __post_init__(self) -> None:
        if self.damping is not None and not 0 <= self.damping <= 1:
            raise InputError(f"--regularize {self.damping}: expected auto, none, or a number from 0 to 1")
        if not 0 <= self.max_error <= 255:
            raise InputError(f"--max-error {self.max_error}: expected 0 to 255 (code values)")
        if not 0 <= self.noise < 1:
            raise InputError(f"--noise {self.noise}: expected 0 up to 1, the share of T's entries that is noise")
        if self.max_cluster is not None and self.max_cluster < 1:
            raise InputError(f"--max-cluster {self.max_cluster}: expected at least 1 projector pixel")


@dataclass(frozen=True)
class Inverse:
    """T⁺ and what was found on the way.

    rows : (projector pixels) rows over camera pixels.  truncation : (projector pixels,) certified change, drive.
    decomposition : the settings and outcome if T was decomposed.
    damping : λ / σ₁; damping_errors : the candidates' errors if λ was chosen.
    halo, window_change : of the windowed clusters, 0 if there are none; the change is measured, in drive.
    window_tolerance : the change that was to be reached.
    """

    rows: SparseRows
    truncation: FloatArray
    clusters: Clusters
    decomposition: tuple[Parameters, Report] | None
    damping: float
    damping_errors: dict[float, float]
    windowed_clusters: int
    halo: int
    window_change: float
    window_tolerance: float

    @property
    def largest_cluster(self) -> tuple[int, int]:
        """Camera and projector pixels of the cluster with the most projector pixels."""
        label = int(np.argmax(self.clusters.projector_sizes))
        return int(self.clusters.camera_sizes[label]), int(self.clusters.projector_sizes[label])

    def matrices(self, camera_pixels: int) -> tuple[Csr, ...]:
        """T⁺ per channel, (projector pixels, camera pixels)."""
        shape = self.rows.indptr.size - 1, camera_pixels
        weights = self.rows.weights.astype(np.float64)
        return tuple(
            sparse.csr_array((weights[:, i], self.rows.indices, self.rows.indptr), shape=shape) for i in range(3)
        )


def invert_near_light(
    near: tuple[Csr, ...],
    mask: NDArray[np.bool_],
    projector_shape: tuple[int, int],
    reach: FloatArray,
    white: float,
    options: InverseOptions,
) -> Inverse:
    """Invert the near light inside the mask; the result's columns outside the mask are empty.

    near : T per channel, (camera pixels, projector pixels).  mask : (camera height, camera width).
    reach : (camera pixels, 3), the largest |c − e| of a picture; within it the certified bound holds.
    white : the radiance of a white picture.
    """
    matrices = tuple(_rows_inside(T, mask) for T in near)
    whole = luminance = _luminance(matrices)
    if whole.nnz == 0:
        raise InputError("no camera pixel inside the mask sees the projector; check the mask and the transport")
    decomposition = None
    if options.max_cluster is not None:
        parameters, cut = decompose_to(matrices, mask.shape, projector_shape, options.max_cluster)
        matrices, decomposition = cut.matrices, (parameters, cut.report)
        luminance = _luminance(matrices)
    clusters = find_clusters(luminance)
    damping, errors = options.damping, dict[float, float]()
    if damping is None:
        choice = choose_damping(luminance, white, mask, whole)
        damping, errors = choice.damping, choice.errors
    lambdas = damping * np.array([largest_singular_value(T) for T in matrices])
    budget = options.max_error / 255
    large = clusters.projector_sizes > (LARGEST_DENSE if damping else LARGEST_PLAIN)
    large |= clusters.projector_sizes * clusters.camera_sizes > LARGEST_BLOCK
    tolerance = max(budget, FINEST_TOLERANCE)

    def invert(blocks: FloatArray, channel: int) -> FloatArray:
        return damped_inverse(blocks, lambdas[channel], options.noise)

    jobs = [clustered_jobs(matrices, clusters, ~large, invert, reach, budget)]
    halo, change = 0, 0.0
    for label in np.flatnonzero(large):
        member = (clusters.projector == label).reshape(projector_shape)
        channels, windows, moved = _plan_windows(matrices, member, mask.shape, lambdas, white, tolerance)
        jobs.append(windowed_jobs(channels, windows, reach, budget))
        halo, change = max(halo, windows.halo), max(change, moved)
    rows, truncation = join(run_jobs(chain(*jobs)), near[0].shape[1])
    return Inverse(
        rows, truncation, clusters, decomposition, damping, errors, int(large.sum()), halo, change, tolerance
    )


def _luminance(matrices: tuple[Csr, ...]) -> Csr:
    """The channels weighted by their luminance, on their shared pattern."""
    indptr, indices, weights = shared_pattern(matrices)
    return sparse.csr_array((weights @ np.array(LUMINANCE, np.float32), indices, indptr), shape=matrices[0].shape)


def _rows_inside(T: Csr, mask: NDArray[np.bool_]) -> Csr:
    """T with the rows outside the mask, and explicit zeros, left out."""
    kept = T.data * np.repeat(mask.ravel(), np.diff(T.indptr))
    inside = sparse.csr_array((kept, T.indices.copy(), T.indptr.copy()), shape=T.shape)
    inside.eliminate_zeros()
    return inside


def _plan_windows(
    matrices: tuple[Csr, ...],
    member: NDArray[np.bool_],
    camera_shape: tuple[int, int],
    lambdas: FloatArray,
    white: float,
    tolerance: float,
) -> tuple[tuple[WindowedChannel, ...], Windows, float]:
    if not lambdas.all():
        size = int(np.count_nonzero(member))
        raise InputError(
            f"--regularize none: a cluster of {size} projector pixels is too large for its plain pseudo-inverse "
            f"(at most {LARGEST_PLAIN}, or {LARGEST_BLOCK >> 20} million entries, are inverted whole); "
            "use --regularize auto, a number, or --max-cluster"
        )
    channels = tuple(WindowedChannel(T, float(damp)) for T, damp in zip(matrices, lambdas, strict=True))
    windows, change = choose_halo(channels[1], member, camera_shape, white, tolerance)
    return channels, windows, change


def run_jobs(jobs: Iterable[Callable[[], Piece]]) -> Iterator[Piece]:
    """Run jobs on all cores, one BLAS thread each (two per job made small factorisations five times slower)."""
    todo = list(jobs)
    with threadpool_limits(limits=1), ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            yield from track(pool.map(lambda job: job(), todo), "inverting", len(todo))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
