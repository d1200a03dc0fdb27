"""T⁺ of a whole room: find clusters, choose λ, invert each part, truncate and join (thesis 4.2.1, 5.1)."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.maps.prior import Prior
from counterlight.maps.row_map import SparseRows
from counterlight.raster import Region
from counterlight.tools.choices import INVERSES
from counterlight.tools.clusters.components import Clusters, find_clusters, no_clusters, refuse_not_finite
from counterlight.tools.clusters.decomposition import Decomposition, Parameters, Report, decompose
from counterlight.tools.clusters.search import decompose_to
from counterlight.tools.inverse import memory
from counterlight.tools.inverse.bidiagonal import largest_singular_values
from counterlight.tools.inverse.clustered import clustered_jobs, prior_matrices
from counterlight.tools.inverse.damping import DampingChoice, choose_damping, is_large
from counterlight.tools.inverse.direct import direct_mapping
from counterlight.tools.inverse.method import LEAST_DAMPING, Method, choose_method
from counterlight.tools.inverse.noise import noise_of_matrix
from counterlight.tools.inverse.price import Objection, price_of_clusters, price_of_windows
from counterlight.tools.inverse.rows import Piece, Truncation, join
from counterlight.tools.inverse.super_blocks import Elsewhere
from counterlight.tools.inverse.windows import FINEST_TOLERANCE, WindowedChannel, Windows, plan_windows, windowed_jobs
from counterlight.tools.jobs import run_jobs
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import CHANNELS, Csr, Shape, Transport, channels, in_one, luminance_matrix

# largest cluster of a cut, in projector pixels (thesis 4.2.2); smaller clusters are no better than direct mapping
MAX_CLUSTER = 1000
THESIS_CLUSTER = 200  # size of clusters for `thesis`, which its plain inverses tolerate (docs/hard_cases.md)
USUAL_TAU = 1e-3  # for `thesis` in rooms with far light, whose T is dense without a threshold
GOLDEN_RATIO = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True)
class InverseOptions:
    """The options of an inverse.

    damping : λ as a fraction of each channel's largest singular value; 0 for the plain pseudo-inverse, None to choose.
    max_error : certified change of a pixel by truncation, in 8-bit code values of linear drive; 0 keeps everything.
    max_cluster : for a cut, largest cluster in projector pixels; None for 1000, or 200 for `thesis`. A number implies a
        cut.
    noise : relative standard deviation of T's entries (0.01 is 1 %); 0 if unknown: then float32 rounding counts.
    inverse : one of choices.INVERSES. `whole` inverts T as it is. `cut` first cuts T into clusters (thesis 4.2.2).
        `none` replaces T⁺ by direct mapping, one entry per row. `auto` is whole if that pays (price.py), else cut, else
        none. `thesis` is chapter 5 to the letter (invert_as_the_thesis).
    parameters : for a cut, replaces the parameters found for a size.
    tau : for `thesis`, drops entries of T below this share of white; None for USUAL_TAU with far light, else 0.
    """

    damping: float | None = None
    max_error: float = 0.5
    max_cluster: int | None = None
    noise: float = 0.0
    inverse: str = "auto"
    parameters: Parameters | None = None
    tau: float | None = None

    def __post_init__(self) -> None:
        if self.inverse not in INVERSES:
            raise InputError(f"--inverse {self.inverse}: expected {', '.join(INVERSES)}")
        given = {f"--max-cluster {self.max_cluster}": self.max_cluster, f"--cut {self.parameters}": self.parameters}
        cuts = [option for option, value in given.items() if value is not None]
        if self.inverse in ("whole", "none") and cuts:
            raise InputError(f"--inverse {self.inverse}: cuts nothing; leave {cuts[0]} out")
        if len(cuts) > 1:
            raise InputError(f"{cuts[1]}: {cuts[0]} finds its own; leave one of them out")
        of_inverses = ("--regularize", self.damping), ("--noise", self.noise)
        unused = [f"{option} {value:g}" for option, value in of_inverses if value]
        if self.inverse == "none" and unused:
            raise InputError(f"{unused[0]}: --inverse none inverts nothing; leave one of them out")
        if self.inverse == "thesis" and self.damping:
            raise InputError(
                f"--regularize {self.damping:g}: --inverse thesis takes plain pseudo-inverses of clusters; leave it out"
            )
        if self.tau is not None and self.inverse != "thesis":
            raise InputError(f"--tau {self.tau:g}: the threshold of --inverse thesis; leave it out, or add that")
        if self.tau is not None and not 0 <= self.tau < 1:
            raise InputError(f"--tau {self.tau:g}: expected 0 up to 1, a share of white")
        if self.damping is not None and not 0 <= self.damping <= 1:
            raise InputError(f"--regularize {self.damping}: expected auto, none, or a number from 0 to 1")
        if not 0 <= self.max_error <= 255:
            raise InputError(f"--max-error {self.max_error}: expected 0 to 255 (code values)")
        if self.max_cluster is not None and self.max_cluster < 1:
            raise InputError(f"--max-cluster {self.max_cluster}: expected at least 1 projector pixel")
        if not 0 <= self.noise < 1:
            raise InputError(f"--noise {self.noise}: expected 0 up to 1, the share of T's entries that is noise")

    @property
    def settled(self) -> "InverseOptions":
        """The options with implied values: the thesis uses no damping."""
        return replace(self, damping=0.0) if self.inverse == "thesis" else self

    @property
    def largest(self) -> int:
        """Largest cluster of a cut, in projector pixels."""
        return self.max_cluster or (THESIS_CLUSTER if self.inverse == "thesis" else MAX_CLUSTER)

    @property
    def requested(self) -> str:
        """The requested inverse, if the other options leave no choice; else "auto"."""
        if self.inverse != "auto":
            return self.inverse
        if self.max_cluster is not None or self.parameters is not None:
            return "cut"
        hardly_damped = self.damping is not None and self.damping < LEAST_DAMPING
        return "whole" if hardly_damped else "auto"


@dataclass(frozen=True)
class Inverse:
    """T⁺ and the results of its computation.

    T_pinv : (projector pixels, camera pixels).
    truncation : (projector pixels, 3). Certified change by dropped entries and by rounding, in drive.
    decomposition : parameters and report if T was decomposed.
    method : which clusters were inverted whole, and which through windows.
    damping : λ / σ₁.
    damping_errors : the candidates' errors if λ was chosen.
    residual : (projector pixels,). ‖r‖₁ of the windows, 0 elsewhere.
    window_tolerance : the residual that windows aim at.
    chosen : whole, cut, none or thesis.
    reason : why, in words, unless it was requested.
    halos : (blocks,). Halos of the windows.
    tau : threshold of the thesis' method, as a share of white; None for other methods.
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
    chosen: str = "whole"
    reason: str = ""
    halos: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    tau: float | None = None

    @property
    def windowed_clusters(self) -> int:
        return int(self.method.windowed.sum())

    @property
    def largest_cluster(self) -> tuple[int, int]:
        """Camera and projector pixels of the cluster with the most projector pixels; 0 if there are no clusters."""
        if not self.clusters.count:
            return 0, 0
        label = int(np.argmax(self.clusters.projector_sizes))
        return int(self.clusters.camera_sizes[label]), int(self.clusters.projector_sizes[label])


@dataclass(frozen=True)
class Conditions:
    """Inputs of an inverse besides T and the options.

    regions : regions of several projectors in one raster.
    weights : (camera pixels,). Diagonal of W, 0 outside the mask; None for 1 inside.
    prior : P; ignored by the plain inverse (λ = 0).
    pictures : (camera height, camera width) each. Pictures for choosing λ; None for the typical ones.
    elsewhere : inverts windows on other machines; None for this process.
    entry_bytes : memory that an entry of T⁺ takes, including later stages.
    """

    regions: Sequence[Region] = ()
    weights: FloatArray | None = None
    prior: Prior | None = None
    pictures: Sequence[FloatArray] | None = None
    elsewhere: Elsewhere | None = None
    entry_bytes: float = memory.ENTRY_BYTES


CONDITIONS = Conditions()


def invert_as_the_thesis(
    transport: Transport,
    camera: Shape,
    projector: Shape,
    reach: FloatArray,
    white: float,
    options: InverseOptions,
) -> Inverse:
    """T⁺ of chapter 5: T above the threshold τ (3.4.2), cut (4.2.2), energy fitted (4.2.3), plainly inverted (5.1).

    The energy adds up to the floodlit room, so light below the threshold is distributed over the rest of its row. Near,
    blurred and far light form one T. All camera pixels have the weight 1, without mask or prior.

    camera, projector : (height, width). The other arguments are as in `invert_near_light`.
    """
    tau = (0.0 if transport.far is None else USUAL_TAU) if options.tau is None else options.tau
    if transport.far is not None and not tau:
        memory.check_in_one(*transport.shape)
    T = in_one(transport, tau * white)
    if tau:
        kept = Transport(T).composition()
        T = T.scaled(np.divide(transport.composition(), kept, out=np.ones_like(kept), where=kept > 0))
    return replace(invert_near_light(T, np.ones(camera, bool), projector, reach, white, options), tau=tau)


def invert_near_light(
    near: SparseRows,
    mask: NDArray[np.bool_],
    projector_shape: tuple[int, int],
    reach: FloatArray,
    white: float,
    options: InverseOptions,
    conditions: Conditions = CONDITIONS,
) -> Inverse:
    """Return (TᵀWT + P + λ²I)⁻¹TᵀW of the near light inside the mask; columns outside the mask are empty.

    near : T, (camera pixels, projector pixels).
    mask : (camera height, camera width).
    reach : (camera pixels, 3). Largest |c − e| of a picture, for which the certified bound holds.
    white : radiance of a white picture.
    """
    weights, prior = conditions.weights, conditions.prior
    weights = mask.ravel().astype(np.float64) if weights is None else weights
    roots = np.sqrt(weights)
    scaled = near.scaled(roots)
    refuse_not_finite(scaled, np.zeros((1, len(CHANNELS))))
    whole = luminance_matrix(scaled)
    if whole.nnz == 0:
        raise InputError("no camera pixel inside the mask sees the projector; check the mask and the transport")
    _check_max_cluster(options, near.columns)
    work = _Work(scaled, whole, mask, projector_shape, reach * roots[:, None], white, options, roots, conditions)
    chosen, reason, found = options.requested, "", None
    if chosen in ("auto", "whole"):
        found = work.inverted(scaled, None, must_pay=chosen == "auto")
        chosen, reason = ("cut", found) if isinstance(found, Objection) else ("whole", "")
    if chosen in ("cut", "thesis"):
        found = work.cut(must_pay=options.requested == "auto")
        if isinstance(found, Objection):
            chosen, reason = "none", f"{reason}; cut, {found}"
    if not isinstance(found, Inverse):
        light = Transport(near.inside(roots > 0))
        found = _directly_mapped(Objective(light, weights, prior, np.ones(near.columns)), find_clusters(whole))
    return replace(found, chosen=chosen, reason=reason)


def mapped_directly(objective: Objective, options: InverseOptions) -> Inverse:
    """Return direct mapping in place of T⁺, for a room with blurred light; raises InputError if T⁺ was requested."""
    if options.requested not in ("auto", "none"):
        raise InputError(
            f"--inverse {options.requested}: blurred light is kept in blocks of pixels, and T⁺ of it would be dense; "
            "leave what asks for T⁺ out, or simulate the room with --tolerance 0 and fewer pixels"
        )
    without = replace(objective, T=objective.T.without_far)
    reason = "blurred light is kept in blocks of pixels" if options.requested == "auto" else ""
    return replace(_directly_mapped(without, no_clusters(objective.T.shape)), chosen="none", reason=reason)


def _directly_mapped(objective: Objective, clusters: Clusters) -> Inverse:
    """Return direct mapping in place of T⁺, for a T without far light."""
    rows = direct_mapping(objective.dual, objective.T.composition(), objective.data_share)
    method = Method(np.zeros(clusters.count, bool), "nothing is inverted")
    nothing = np.zeros((objective.T.shape[1], len(CHANNELS)))
    return Inverse(rows, nothing, clusters, None, method, 0.0, {}, nothing[:, 0], 0.0)


@dataclass(frozen=True)
class _Work:
    """The matrix to invert, and the options. Rows of T and reach are multiplied by the root of their weight.

    whole : luminance of `near`. The other fields are arguments of `invert_near_light`.
    """

    near: SparseRows
    whole: Csr
    mask: NDArray[np.bool_]
    projector_shape: tuple[int, int]
    reach: FloatArray
    white: float
    options: InverseOptions
    roots: FloatArray
    conditions: Conditions

    def cut(self, *, must_pay: bool) -> "Inverse | Objection":
        """Return T⁺ of T cut into clusters, or the reason against it if `must_pay` and it does not pay."""
        try:
            parameters, cut = self._decomposed()
        except InputError as error:
            if must_pay:
                return Objection(str(error))
            raise
        return self.inverted(cut.near, (parameters, cut.report), must_pay=must_pay)

    def _decomposed(self) -> tuple[Parameters, Decomposition]:
        shapes, given = (self.mask.shape, self.projector_shape), self.options.parameters
        if given is not None:
            return given, decompose(self.near, *shapes, given)
        size, named = min(self.options.largest, self.near.columns), self.options.max_cluster is not None
        return decompose_to(self.near, *shapes, size, or_smallest=self.options.inverse == "thesis" and not named)

    def inverted(
        self, near: SparseRows, decomposition: tuple[Parameters, Report] | None, *, must_pay: bool
    ) -> "Inverse | Objection":
        """Return T⁺ of these rows, or the reason against it, before the work, if `must_pay` and it does not pay."""
        light = self.whole if near is self.near else luminance_matrix(near)
        clusters = find_clusters(light)
        method = choose_method(clusters, self.options.damping)
        price = price_of_clusters(clusters, ~method.windowed)
        if must_pay and (objection := price.objection()):
            return objection
        memory.check_whole(clusters, ~method.windowed)
        matrices = channels(near)
        found = largest_singular_values((*matrices, light) if self.options.damping is None else matrices)
        sigmas = found[: len(CHANNELS)]
        _check_lit(sigmas)
        choice = self._choose_damping(matrices, sigmas, light, found[-1])
        lambdas = choice.damping * sigmas
        prior = self.conditions.prior if choice.damping > 0 else None
        priors = None if prior is None else prior_matrices(prior, clusters.projector)
        truncation = Truncation(self.reach, self.options.max_error / 255)
        tolerance = max(truncation.budget, FINEST_TOLERANCE)
        jobs = [clustered_jobs(matrices, clusters, ~method.windowed, lambdas, self.options.noise, truncation, priors)]
        done: Iterable[Piece] = ()
        if method.windowed.any():
            member = np.isin(clusters.projector, np.flatnonzero(method.windowed)).reshape(self.projector_shape)
            if must_pay:
                green = matrices[1], float(lambdas[1]), None if priors is None else priors[1]
                price = price + price_of_windows(*green, member, truncation, tolerance, self.conditions.regions)
                if objection := price.objection():
                    return objection
            plan = _windowed(matrices, lambdas, priors, member, tolerance, self.conditions.regions)
            if self.conditions.elsewhere is None:
                jobs.append(windowed_jobs(*plan, truncation, tolerance))
            else:
                done = self.conditions.elsewhere.pieces(*plan, truncation, tolerance)
        sizes = clusters.projector_sizes
        whole, windowed = int(sizes[~method.windowed].sum()), int(sizes[method.windowed].sum())
        pieces = _run(list(chain(*jobs)), done, whole, windowed, self.conditions.entry_bytes)
        joined = join(pieces, near.shape[::-1])
        weights = joined.rows.weights * self.roots[joined.rows.indices, None].astype(np.float32)
        return Inverse(
            replace(joined.rows, weights=weights),
            joined.changed,
            clusters,
            decomposition,
            method,
            choice.damping,
            choice.errors,
            joined.residual,
            tolerance,
            halos=np.array([piece.halo for piece in pieces if piece.halo], np.int64),
        )

    def _choose_damping(
        self, matrices: tuple[Csr, ...], sigmas: FloatArray, light: Csr, largest: float
    ) -> DampingChoice:
        """Return the requested λ / σ₁, or the chosen one, at least the noise of any channel.

        sigmas : σ₁ of each channel.
        largest : σ₁ of `light`; not used if λ is requested.
        """
        if self.options.damping is not None:
            return DampingChoice(self.options.damping, {})
        if not is_large(light):
            memory.check_choice(light.shape[1])
        noise = [noise_of_matrix(T, self.options.noise) for T in matrices]
        floor = max(float(n / sigma) for n, sigma in zip(noise, sigmas, strict=True))
        white = self.white * self.roots.reshape(self.mask.shape)
        return choose_damping(light, white, self.mask, self.whole, floor, self.conditions.pictures, largest)


def _check_lit(sigmas: FloatArray) -> None:
    """Raise InputError if a channel's σ₁ is 0."""
    for name, sigma in zip(CHANNELS, sigmas, strict=True):
        if sigma == 0:
            raise InputError(f"transport_{name}: no entry inside the mask; check the channel's file and mask.png")


def _check_max_cluster(options: InverseOptions, projector_pixels: int) -> None:
    if options.max_cluster is not None and options.max_cluster > projector_pixels:
        raise InputError(
            f"--max-cluster {options.max_cluster}: the projector has {projector_pixels} pixels; expected at most that, "
            "or leave the option out to cut nothing"
        )


def _windowed(
    matrices: tuple[Csr, ...],
    lambdas: FloatArray,
    priors: tuple[Csr, ...] | None,
    member: NDArray[np.bool_],
    tolerance: float,
    regions: Sequence[Region],
) -> tuple[tuple[WindowedChannel, ...], Windows]:
    memory.check_windows(matrices[1], int(member.sum()))
    drawn = priors or (None,) * len(matrices)
    parts = zip(matrices, lambdas, drawn, strict=True)
    channels = tuple(WindowedChannel(T, float(damp), each) for T, damp, each in parts)
    return channels, plan_windows(channels[1], member, tolerance, regions).windows


def _run(
    jobs: list[Callable[[], Piece]], elsewhere: Iterable[Piece], whole: int, windowed: int, entry_bytes: float
) -> list[Piece]:
    """Run the jobs in a mixed order, so that the first few are a fair sample and memory is predicted early.

    elsewhere : pieces from other machines.
    whole, windowed, entry_bytes : see memory.checked_as_they_come.
    """
    spread = [jobs[i] for i in np.argsort(np.arange(len(jobs)) * GOLDEN_RATIO % 1)]
    with closing(run_jobs(spread, "inverting")) as results:
        return list(memory.checked_as_they_come(chain(results, elsewhere), whole, windowed, entry_bytes))
