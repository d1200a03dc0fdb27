"""The objective that map, refinement, box and certificate all minimise, per channel (docs/mathematics.md 2):

    ½ Σ w (T p − b)²  +  ½ Σ η p²  +  ½ Σ ω (p_j − p_k)²,        0 ≤ p ≤ 1.

w : trust in a camera pixel (trust.py).
η : damping of projector pixels that no camera pixel sees, or, with --avoid-highlights, that cameras see by gloss
    (gloss.py).
ω : ties between neighbours, so that the picture tolerates a drift of the projector.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.maps.mixing import Mixing
from counterlight.maps.prior import Prior, pull
from counterlight.maps.row_map import SparseRows
from counterlight.pipeline.refinement import OVER_RELAXATION, Certificate, momentum
from counterlight.raster import Region
from counterlight.tools.choices import OUTSIDE
from counterlight.tools.transport.gloss import glossy
from counterlight.tools.transport.overlap import overlap
from counterlight.tools.transport.transport import Transport
from counterlight.tools.transport.trust import LEAST_TRUST, camera_pixels, seen, shares, trust

FAINTEST = 1e-12  # share of the channel's largest d; projector pixels below it light nothing: their step would overflow
FINEST = 1e-6  # share of ½ Σ w b²; an error 60 dB below the target needs no finer certificate
HARDLY_SEEN = 0.02  # share of the usual visibility; at this value, the prior is as strong as the camera's data
FALL = 4  # the power by which the prior fades with visibility: 2e-7 of d for fully seen pixels
HARDLY_LIT = 3e-4  # share of the usual d; far light alone gives 0.001 to 0.15 in a bright room, noise 0.00001
BY_FAR_LIGHT = 1e-3  # share of d; costs folded_cards 0.2 dB of an even grey, and 0.005 would cost 0.5 dB
ALONE = 0.9  # share of d; a pixel with more far light counts as seen by far light alone
TINY, LARGEST = 1e-30, 1e6
# share of d if all light is gloss: no loss where other projectors light the place, a twentieth elsewhere
AVOIDED = 0.05
STIFFNESS = 0.03  # share of d; ties of unseen pixels to their neighbours (--outside continue)


@dataclass(frozen=True)
class ObjectiveOptions:
    """Options of the objective.

    drift : σ, projector pixels by which the picture may shift.
    outside : one of choices.OUTSIDE. Treatment of pixels that no camera sees.
    avoid_highlights : use another projector where the camera sees gloss (gloss.py).
    """

    drift: float = 0.05
    outside: str = "black"
    avoid_highlights: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.drift <= 10:
            raise InputError(f"--drift {self.drift}: expected 0 to 10 projector pixels")
        if self.outside not in OUTSIDE:
            raise InputError(f"--outside {self.outside}: expected {', '.join(OUTSIDE)}")


DEFAULT_AIMS = ObjectiveOptions()
INDEPENDENT = Mixing()


@dataclass(frozen=True)
class Objective:
    """The objective of one room; p is (projector pixels, 3), b (camera pixels, 3).

    T : transport; rows of camera pixels without weight are empty.
    weights : w, (camera pixels,).
    seen : (projector pixels,). How well trusted camera pixels see each pixel, 1 for most pixels.
    bounds : whether b is limited to the light that each camera pixel can reach by itself. Without this limit, an
        unreachable b would make its neighbours too bright.
    mixing : mixing of the camera's colours, which defines the nearest possible light.
    lit : (camera pixels,). Pixels that figures refer to; None for all.
    """

    T: Transport
    weights: FloatArray
    prior: Prior | None
    seen: FloatArray
    bounds: bool = True
    mixing: Mixing = INDEPENDENT
    lit: BoolArray | None = None

    @classmethod
    def plain(cls, T: Transport) -> "Objective":
        """Return ½‖T p − b‖² alone, for unlimited b."""
        return cls(T, np.ones(T.shape[0]), None, np.ones(T.shape[1]), bounds=False)

    @cached_property
    def unweighted(self) -> "Objective":
        """½‖T p − b‖² over the lit camera pixels. Its optimum is the zero of every "dB below the best"."""
        return replace(self.plain(self.T if self.lit is None else self.T.inside(self.lit)), lit=self.lit)

    def lit_picture(self, calibration: Calibration) -> BoolArray:
        """Return the lit camera pixels, (camera height, camera width)."""
        lit = np.ones(self.T.shape[0], bool) if self.lit is None else self.lit
        return lit.reshape(calibration.camera.shape)

    @cached_property
    def dual(self) -> Transport:
        """Tᵀ W."""
        return self.T.scaled(self.weights).T

    def bounded(self, b: FloatArray) -> FloatArray:
        """Return b limited to 0..T·1, as solved for."""
        return np.asarray(self.mixing.within(b, self._most), np.float64) if self.bounds else b

    def light_outside(self, drive: FloatArray, plain: FloatArray | None = None) -> float | None:
        """Return the drive of unseen pixels, relative to their drive in `plain`; None if that is 0.

        drive, plain : (projector pixels, 3). None for full drive.
        """
        unseen = np.maximum(1 - self.seen, 0)[:, None]
        usual = float(np.sum(unseen * (np.ones_like(drive) if plain is None else plain)))
        return float(np.sum(unseen * drive)) / usual if usual > 0 else None

    @cached_property
    def _most(self) -> FloatArray:
        """T·1, (camera pixels, 3)."""
        return self.T.composition()

    @cached_property
    def curvature(self) -> FloatArray:
        """d + η + 2 Σ ω with d = TᵀW T·1, (projector pixels, 3). As T ≥ 0, this diagonal bounds the Hessian."""
        return self._sums if self.prior is None else self._sums + self.prior.bound.reshape(-1, 3)

    @property
    def data_share(self) -> FloatArray:
        """d / (d + η), (projector pixels, 3): the weight of the camera's data against the prior; 1 without a prior."""
        if self.prior is None:
            return np.ones((self.T.shape[1], 3))
        d, damping = self._sums, self.prior.damping.reshape(-1, 3)
        return np.divide(d, d + damping, out=np.zeros_like(d), where=d > 0)

    @cached_property
    def _sums(self) -> FloatArray:
        """d = TᵀW T·1."""
        return self.dual.apply(self._most)

    @property
    def by_far_light(self) -> FloatArray:
        """The part of d that is far light, (projector pixels, 3)."""
        if self.T.far is None:
            return np.zeros_like(self._sums)
        return np.maximum(self._sums - self.dual.without_far.apply(self._most), 0)

    @cached_property
    def step_size(self) -> FloatArray:
        """1 / curvature; 0 for pixels without light and prior."""
        total = self.curvature
        return np.divide(1.0, total, out=np.zeros_like(total), where=total > FAINTEST * total.max(axis=0, initial=0.0))

    def descent(self, p: FloatArray, b: FloatArray) -> FloatArray:
        """Return TᵀW (b − T p) − P p, the negative gradient. b must be bounded."""
        return self.dual.apply(b - self.T.apply(p)) - self._pull(p)

    def steps(self, p: FloatArray, b: FloatArray) -> Iterator[FloatArray]:
        """Yield p and then every further step of the player, without end. b must be bounded."""
        y = p
        for step in count(1):
            yield p
            q = np.clip(y + self.step_size * self.descent(y, b), 0, 1)
            y = q + momentum(step) * (q - p) + OVER_RELAXATION * (q - y)
            p = q

    def certificate(self, p: FloatArray, b: FloatArray, upper: float = 1.0) -> Certificate:
        """Return the bound for any 0 ≤ p ≤ upper. The error is weighted, without the prior's term."""
        residual = self.bounded(b) - self.T.apply(p)
        gradient = self._pull(p) - self.dual.apply(residual)
        reach = upper if np.isfinite(upper) else np.maximum(1.0, 2 * p.max(axis=0, initial=0.0))
        gap = np.maximum(gradient * p, gradient * (p - reach)).sum(axis=0)
        return Certificate(np.sum(self.weights[:, None] * residual**2, axis=0), gap)

    def value(self, p: FloatArray, b: FloatArray) -> FloatArray:
        """Return the objective, (3,)."""
        squares = self.weights[:, None] * (self.bounded(b) - self.T.apply(p)) ** 2
        return np.asarray((squares.sum(axis=0) + np.sum(p * self._pull(p), axis=0)) / 2)

    def relative_gap(self, p: FloatArray, b: FloatArray, upper: float = 1.0) -> FloatArray:
        """Return the gap relative to the objective, (3,), or relative to ½ Σ w b² minus 60 dB if that is larger."""
        found, target = self.certificate(p, b, upper), np.sum(self.weights[:, None] * b**2, axis=0)
        scale = np.maximum(self.value(p, b), FINEST * target / 2)
        return np.asarray(np.divide(found.gap, scale, out=np.zeros_like(scale), where=scale > 0))

    def _pull(self, p: FloatArray) -> FloatArray:
        if self.prior is None:
            return np.zeros_like(p)
        shape = self.prior.damping.shape
        pulled = pull(p.reshape(shape), self.prior.damping, self.prior.right, self.prior.down)
        return np.asarray(pulled.reshape(-1, 3), np.float64)


def objective_of(
    transport: Transport, calibration: Calibration, options: ObjectiveOptions, mixing: Mixing = INDEPENDENT
) -> Objective:
    """Return the objective of a calibrated room. mixing : between T's light and the camera's colours."""
    projector, regions = calibration.projector.shape, calibration.regions
    trusted = _trust(transport, calibration)
    T = transport.inside(trusted > 0)
    lit, weights = trusted > LEAST_TRUST, trusted * shares(transport.near, calibration)
    unaided = Objective(T, weights, None, seen(T, lit), mixing=mixing, lit=lit)
    prior = _prior(unaided, projector, regions, options)
    return replace(unaided, prior=_off_highlights(unaided, prior, calibration) if options.avoid_highlights else prior)


def _off_highlights(objective: Objective, prior: Prior, calibration: Calibration) -> Prior:
    """Return the prior with additional damping for pixels that are seen by gloss."""
    projector, regions = calibration.projector.shape, calibration.regions
    if len(regions) == 1:
        raise InputError("--avoid-highlights: of one projector; leave it out, or join a second one (counterlight join)")
    shares = glossy(objective.T, calibration, owners(projector, regions))
    away = (AVOIDED * shares[:, None] * objective.curvature).reshape(*projector, 3)
    return replace(prior, damping=(prior.damping + away).astype(np.float32))


def _trust(T: Transport, calibration: Calibration) -> FloatArray:
    """Return the trust in each camera pixel, per camera, because neighbourhoods belong to one camera's picture."""
    if calibration.screen is None:
        return trust(T, calibration.mask, calibration.projector.shape)
    weights = np.zeros(calibration.mask.shape)
    pixels = np.arange(weights.size).reshape(weights.shape)
    for view in calibration.views:
        found = trust(T.at(pixels[view].ravel()), calibration.mask[view], calibration.projector.shape)
        weights[view] = found.reshape(weights[view].shape)
    return weights.ravel()


def _prior(
    objective: Objective,
    projector: tuple[int, int],
    regions: Sequence[Region],
    options: ObjectiveOptions,
) -> Prior:
    d, diagonal = objective.curvature, _diagonal(objective.T, objective.weights)
    least = 1.0 if options.outside == "dark" else BY_FAR_LIGHT
    hold = _hold(d, objective.by_far_light, objective.seen, least)
    black = options.outside != "continue"
    stiff = np.zeros_like(hold) if black else np.minimum(hold, STIFFNESS * hold.max(axis=0))
    ties = [each.reshape(*projector, 3) for each in (options.drift * np.sqrt(diagonal), stiff)]
    owner = owners(projector, regions)
    apart = _apart(objective, projector)
    right, down = (_ties(ties[0], ties[1], each, owner, axis) for each, axis in zip(apart, (1, 0), strict=True))
    damping = hold if black else np.zeros_like(hold)
    return Prior(damping.reshape(*projector, 3).astype(np.float32), right, down)


def _diagonal(T: Transport, weights: FloatArray) -> FloatArray:
    """Return the diagonal of (S + B P)ᵀW(S + B P), (projector pixels, 3). A row addresses each pixel only once."""
    diagonal = _squares(T.near, weights[:, None])
    if T.blurred is not None:
        diagonal += _squares(T.blurred.gather, _squares(T.blurred.scatter, weights[:, None]))
    return diagonal


def _squares(rows: SparseRows, weights: FloatArray) -> FloatArray:
    """Return Σ_i w_i A_ij² of every column, (columns, 3). weights : (rows, 1 or 3)."""
    each = np.broadcast_to(weights, (rows.shape[0], 3))
    squares = [
        np.bincount(rows.indices, each[rows.rows, i] * rows.weights[:, i].astype(np.float64) ** 2, rows.columns)
        for i in range(3)
    ]
    return np.stack(squares, axis=1)


def _hold(d: FloatArray, far: FloatArray, shown: FloatArray, least: float) -> FloatArray:
    """Return the damping of each projector pixel due to low visibility, (projector pixels, 3); at most the usual d.

    Pixels seen directly: d (0.02 / shown)⁴. Pixels seen by far light alone: d (0.0003 / d)⁴, in shares of the usual d,
    and at least `least` d: with 0.001, many such pixels together may brighten a room, but noise may not.

    far : the part of d that is far light.
    shown : visibility of each pixel.
    """
    usual = np.median(d[shown > 0.5], axis=0) if np.any(shown > 0.5) else d.max(axis=0, initial=0.0)
    light = np.divide(d, usual, out=np.zeros_like(d), where=usual > 0)
    alone = far > ALONE * d
    hardly = np.where(alone, HARDLY_LIT / np.maximum(light, TINY), HARDLY_SEEN / np.maximum(shown, TINY)[:, None])
    strength = np.minimum(hardly, LARGEST) ** FALL
    held = np.minimum(np.where(alone, np.maximum(strength, least), strength) * d, usual)
    return np.where(d > 0, held, usual)  # factors of a dense T may give slightly negative values


def _apart(objective: Objective, projector: tuple[int, int]) -> Iterator[FloatArray]:
    """Yield 1 − κ of pixels and their right neighbours, then lower neighbours; 1 if too little is seen to compute κ.

    If a projector pixel fills less than a camera pixel, neighbours look alike only because of the coarse camera.
    """
    made = camera_pixels(objective.T, objective.weights > 0)
    known = np.minimum(np.minimum(objective.seen, made), 1).reshape(projector)
    for alike, axis in zip(overlap(objective.T, objective.weights, projector), (1, 0), strict=True):
        yield 1 - np.minimum(known, np.roll(known, -1, axis)) * alike


def owners(projector: tuple[int, int], regions: Sequence[Region]) -> NDArray[np.int64]:
    """Return the number of each pixel's projector, (projector height, projector width); -1 for none."""
    owner = np.full(projector, -1 if regions else 0)
    for number, region in enumerate(regions):
        owner[region.part] = number
    return owner


def _ties(
    root: FloatArray, stiff: FloatArray, apart: FloatArray, owner: NDArray[np.int64], axis: int
) -> NDArray[np.float32]:
    """Return ω between each pixel and the next along an axis; 0 at the end and between projectors.

    root : σ √diag(TᵀWT). The product of two roots keeps a dark pixel from being tied to a bright one.
    stiff : additional stiffness of each pixel.
    apart : 1 − κ of each pixel and the next.
    """
    count = owner.shape[axis] - 1
    pairs = [(np.take(each, range(count), axis), np.take(each, range(1, count + 1), axis)) for each in (root, stiff)]
    one_picture = (np.diff(owner, axis=axis) == 0) & (np.take(owner, range(count), axis) >= 0)
    drifting = np.take(apart, range(count), axis)[..., None] * pairs[0][0] * pairs[0][1]
    ties = (drifting + (pairs[1][0] + pairs[1][1]) / 2) * one_picture[..., None]
    return np.pad(ties, [(0, int(each == axis)) for each in range(3)]).astype(np.float32)
