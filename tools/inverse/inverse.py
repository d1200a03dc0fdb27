"""T⁺ of a whole room: clusters found, λ chosen, each part inverted, truncated and joined (thesis 4.2.1, 5.1)."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.calibration import Region
from counterlight.errors import InputError
from counterlight.maps.prior import Prior
from counterlight.maps.row_map import SparseRows
from counterlight.tools.choices import INVERSE_METHODS
from counterlight.tools.clusters.components import Clusters, find_clusters
from counterlight.tools.clusters.decomposition import Parameters, Report
from counterlight.tools.clusters.finite import refuse_not_finite
from counterlight.tools.clusters.search import decompose_to
from counterlight.tools.inverse import memory
from counterlight.tools.inverse.bidiagonal import largest_singular_value
from counterlight.tools.inverse.clustered import clustered_jobs
from counterlight.tools.inverse.damping import DampingChoice, choose_damping
from counterlight.tools.inverse.method import Method, choose_method
from counterlight.tools.inverse.noise import noise_of_matrix
from counterlight.tools.inverse.pieces import Piece, Truncation, join
from counterlight.tools.inverse.priors import prior_matrices
from counterlight.tools.inverse.windowed import FINEST_TOLERANCE, WindowedChannel, plan_windows, windowed_jobs
from counterlight.tools.jobs import run_jobs
from counterlight.tools.transport.transport import CHANNELS, Csr, channels, luminance_matrix

GOLDEN_RATIO = (np.sqrt(5) - 1) / 2

TRUNCATED = 0.6  # of --max-error; the rest is for T⁺'s weights in words of 4 bytes (player/maps/small_correction.py)


@dataclass(frozen=True)
class InverseOptions:
    """How to invert.

    damping : λ as a fraction of each channel's largest singular value, 0 for the plain pseudo-inverse, None to choose.
    max_error : certified change of a pixel by truncation, in 8-bit code values of linear drive; 0 keeps everything.
    max_cluster : decompose T into clusters of at most so many projector pixels (thesis 4.2.2); None leaves it whole.
    noise : of T's entries, relative, standard deviation (0.01 is 1 %); 0 if unknown: then float32 rounding counts.
    method : clusters inverted whole, through windows, or as their sizes allow (choices.INVERSE_METHODS).
    """

    damping: float | None = None
    max_error: float = 0.5
    max_cluster: int | None = None
    noise: float = 0.0
    method: str = "auto"

    def __post_init__(self) -> None:
        if self.damping is not None and not 0 <= self.damping <= 1:
            raise InputError(f"--regularize {self.damping}: expected auto, none, or a number from 0 to 1")
        if not 0 <= self.max_error <= 255:
            raise InputError(f"--max-error {self.max_error}: expected 0 to 255 (code values)")
        if self.max_cluster is not None and self.max_cluster < 1:
            raise InputError(f"--max-cluster {self.max_cluster}: expected at least 1 projector pixel")
        if not 0 <= self.noise < 1:
            raise InputError(f"--noise {self.noise}: expected 0 up to 1, the share of T's entries that is noise")
        if self.method not in INVERSE_METHODS:
            raise InputError(f"--method {self.method}: expected {', '.join(INVERSE_METHODS)}")


@dataclass(frozen=True)
class Inverse:
    """T⁺ and what was found on the way.

    T_pinv : (projector pixels, camera pixels).
    truncation : (projector pixels, 3), certified change by what was left out and by rounding, drive.
    decomposition : the settings and outcome if T was decomposed.
    method : what was inverted whole and what through windows.
    damping : λ / σ₁; damping_errors : the candidates' errors if λ was chosen.
    residual : (projector pixels,), ‖r‖₁ of the windows, 0 elsewhere; what they were to reach is window_tolerance.
    halos : (blocks,) of the windows.
    """

    T_pinv: SparseRows
    truncation: FloatArray
    clusters: Clusters
    decomposition: tuple[Parameters, Report] | None
    method: Method
    damping: float
    damping_errors: dict[float, float]
    residual: FloatArray
    window_tolerance: float
    halos: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))

    @property
    def windowed_clusters(self) -> int:
        return int(self.method.windowed.sum())

    @property
    def largest_cluster(self) -> tuple[int, int]:
        """Camera and projector pixels of the cluster with the most projector pixels."""
        label = int(np.argmax(self.clusters.projector_sizes))
        return int(self.clusters.camera_sizes[label]), int(self.clusters.projector_sizes[label])


def invert_near_light(
    near: SparseRows,
    mask: NDArray[np.bool_],
    projector_shape: tuple[int, int],
    reach: FloatArray,
    white: float,
    options: InverseOptions,
    regions: Sequence[Region] = (),
    weights: FloatArray | None = None,
    prior: Prior | None = None,
) -> Inverse:
    """(TᵀWT + P + λ²I)⁻¹TᵀW of the near light inside the mask; the result's columns outside the mask are empty.

    near : T, (camera pixels, projector pixels).  mask : (camera height, camera width).
    reach : (camera pixels, 3), the largest |c − e| of a picture; within it the certified bound holds.
    white : the radiance of a white picture.  regions : of several projectors in one raster.
    weights : W's diagonal, (camera pixels,), 1 if nobody says; 0 outside the mask.
    prior : P; the plain inverse (λ = 0) knows none.
    """
    roots = mask.ravel().astype(np.float64) if weights is None else np.sqrt(weights)
    near, reach = near.scaled(roots), reach * roots[:, None]
    refuse_not_finite(near, np.zeros((1, len(CHANNELS))))
    whole = light = luminance_matrix(near)
    if whole.nnz == 0:
        raise InputError("no camera pixel inside the mask sees the projector; check the mask and the transport")
    _check_max_cluster(options, near.columns)
    decomposition = None
    if options.max_cluster is not None:
        parameters, cut = decompose_to(near, mask.shape, projector_shape, options.max_cluster)
        near, decomposition = cut.near, (parameters, cut.report)
        light = luminance_matrix(near)
    matrices = channels(near)
    clusters = find_clusters(light)
    method = choose_method(clusters, options.method, options.damping)
    memory.check_whole(clusters, ~method.windowed)
    sigmas = _largest_singular_values(matrices)
    choice = _choose_damping(matrices, sigmas, light, whole, white * roots.reshape(mask.shape), mask, options)
    lambdas = choice.damping * sigmas
    priors = None if prior is None or choice.damping == 0 else prior_matrices(prior, clusters.projector)
    truncation = Truncation(reach, TRUNCATED * options.max_error / 255)
    tolerance = max(options.max_error / 255, FINEST_TOLERANCE)
    jobs = [clustered_jobs(matrices, clusters, ~method.windowed, lambdas, options.noise, truncation, priors)]
    if method.windowed.any():
        member = np.isin(clusters.projector, np.flatnonzero(method.windowed)).reshape(projector_shape)
        jobs.append(_windowed(matrices, lambdas, priors, member, truncation, tolerance, regions))
    pieces = _run(list(chain(*jobs)), int(clusters.projector_sizes.sum()))
    joined = join(pieces, near.shape[::-1])
    rows = replace(joined.rows, weights=joined.rows.weights * roots[joined.rows.indices, None].astype(np.float32))
    halos = np.array([piece.halo for piece in pieces if piece.halo], np.int64)
    return Inverse(
        rows,
        joined.changed,
        clusters,
        decomposition,
        method,
        choice.damping,
        choice.errors,
        joined.residual,
        tolerance,
        halos,
    )


def _largest_singular_values(matrices: tuple[Csr, ...]) -> FloatArray:
    """σ₁ of each channel; InputError if one is 0."""
    sigmas = np.array([largest_singular_value(T) for T in matrices])
    for name, sigma in zip(CHANNELS, sigmas, strict=True):
        if sigma == 0:
            raise InputError(f"transport_{name}: no entry inside the mask; check the channel's file and mask.png")
    return sigmas


def _check_max_cluster(options: InverseOptions, projector_pixels: int) -> None:
    if options.max_cluster is not None and options.max_cluster > projector_pixels:
        raise InputError(
            f"--max-cluster {options.max_cluster}: the projector has {projector_pixels} pixels; expected at most that, "
            "or leave the option out to cut nothing"
        )


def _choose_damping(
    matrices: tuple[Csr, ...],
    sigmas: FloatArray,
    light: Csr,
    whole: Csr,
    white: FloatArray,
    mask: NDArray[np.bool_],
    options: InverseOptions,
) -> DampingChoice:
    """λ / σ₁ as asked for, or chosen, not below the noise of any channel."""
    if options.damping is not None:
        return DampingChoice(options.damping, {})
    memory.check_choice(light.shape[1])
    noise = [noise_of_matrix(T, options.noise) for T in matrices]
    floor = max(float(n / sigma) for n, sigma in zip(noise, sigmas, strict=True))
    return choose_damping(light, white, mask, whole, floor)


def _windowed(
    matrices: tuple[Csr, ...],
    lambdas: FloatArray,
    priors: tuple[Csr, ...] | None,
    member: NDArray[np.bool_],
    truncation: Truncation,
    tolerance: float,
    regions: Sequence[Region],
) -> Iterator[Callable[[], Piece]]:
    memory.check_windows(matrices[1], int(member.sum()))
    drawn = priors or (None,) * len(matrices)
    parts = zip(matrices, lambdas, drawn, strict=True)
    channels = tuple(WindowedChannel(T, float(damp), each) for T, damp, each in parts)
    windows = plan_windows(channels[1], member, tolerance, regions)
    return windowed_jobs(channels, windows, truncation, tolerance)


def _run(jobs: list[Callable[[], Piece]], row_count: int) -> list[Piece]:
    """Run the jobs in an order of which every beginning is spread over them all, so that memory is foretold early."""
    spread = [jobs[i] for i in np.argsort(np.arange(len(jobs)) * GOLDEN_RATIO % 1)]
    with closing(run_jobs(spread, "inverting")) as results:
        return list(memory.checked_as_they_come(results, row_count))
