"""Hard cases as data, and the methods: studies/hard_cases.py measures them, test_hard_*.py test known properties."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

import counterlight as cl
from counterlight.pipeline.content import reachable_white
from counterlight.tools.inverse.bidiagonal import largest_singular_value
from counterlight.tools.inverse.far_light import undo_far_light
from counterlight.tools.inverse.near_light import Inverse, InverseOptions, invert_near_light
from counterlight.tools.inverse.pictures import typical_pictures
from counterlight.tools.solve.registry import SOLVERS
from counterlight.tools.transport.transport import Csr, FarLight, channels, far_light_of, stacked
from tests.one_channel import linear_system, solve
from tests.rooms import blurred_transport

FloatArray = NDArray[np.float64]
Apply = Callable[[FloatArray], FloatArray]  # b (camera pixels,) -> p (projector pixels,), not clamped
KEEP_ALL = 0.0
CUT = 40  # largest cluster of the decomposed map, in projector pixels
NOISE = 0.01
LARGEST_SVD = 1200
SEED = 20060504
CONDITIONS = tuple(10.0**k for k in range(2, 15, 2))
WALL_CAMERA, WALL_PROJECTOR = (15, 19), (12, 16)
LARGE_CAMERA, LARGE_PROJECTOR = (80, 105), (32, 64)


@dataclass(frozen=True)
class HardCase:
    """System of equations, with what makes it hard.

    T : (camera pixels, projector pixels), given to a method.
    target : b = c − e, (camera pixels,).
    camera, projector : (height, width).
    truth : the room's true transport; T if None.
    far : part of T that a map removes from the picture before it inverts the rest; None if absent.
    """

    name: str
    T: Csr
    target: FloatArray
    camera: tuple[int, int]
    projector: tuple[int, int]
    truth: Csr | None = None
    far: FarLight | None = None

    @cached_property
    def dense(self) -> FloatArray:
        return np.asarray(self.T.toarray(), np.float64)

    @cached_property
    def singular(self) -> tuple[FloatArray, FloatArray] | None:
        """U and σ of T without singular values of 0; None if T is too large for an SVD."""
        if self.T.shape[1] > LARGEST_SVD:
            return None
        U, sigma, _ = np.linalg.svd(self.dense, full_matrices=False)
        kept = sigma > 0
        return U[:, kept], sigma[kept]

    @cached_property
    def largest_singular_value(self) -> float:
        return largest_singular_value(self.T) if self.singular is None else float(self.singular[1][0])

    @property
    def seen_by(self) -> Csr:
        return self.T if self.truth is None else self.truth

    @property
    def floodlight(self) -> FloatArray:
        """T·1, (camera pixels,)."""
        return np.asarray(self.seen_by @ np.ones(self.T.shape[1]))

    def error(self, p: FloatArray, target: FloatArray | None = None) -> float:
        """RMS camera error after the clamp, as a share of the floodlit room's RMS."""
        residual = self.seen_by @ np.clip(p, 0, 1) - (self.target if target is None else target)
        return float(np.linalg.norm(residual) / np.linalg.norm(self.floodlight))


def listed(name: str, T: ArrayLike, target: ArrayLike) -> HardCase:
    """Case whose pixels have no neighbours: pictures of a single row."""
    matrix = Csr(np.asarray(T, np.float64))
    shapes = (1, matrix.shape[0]), (1, matrix.shape[1])
    return HardCase(name, matrix, np.asarray(target, np.float64), *shapes)


def rng(extra: int = 0) -> np.random.Generator:
    return np.random.default_rng(SEED + extra)


# Linear algebra


def conflicting_rows() -> HardCase:
    """Two camera pixels see the same projector pixel but have different targets; the mean is optimal."""
    return listed("conflicting rows", [[0.8, 0], [0.8, 0], [0, 0.5]], [0.2, 0.6, 0.25])


def parallel_columns(gap: float) -> HardCase:
    """Two projector pixels with nearly equal columns a and a + gap·d: condition ≈ 2 / gap; solution p = (0.3, 0.6)."""
    a, d = np.full(4, 0.5), np.array([0.5, -0.5, 0.5, -0.5])
    T = np.stack([a, a + gap * d], axis=1)
    name = f"parallel columns, condition {2 / gap:.0e}" if gap else "parallel columns, exactly"
    return listed(name, T, 0.9 * a + 0.6 * gap * d)


def rank_deficient(shape: tuple[int, int]) -> HardCase:
    """Rank min(shape) − 2, and a target that no drive reaches."""
    m, n = shape
    rank, numbers = min(shape) - 2, rng(m)
    T = numbers.uniform(size=(m, rank)) @ numbers.uniform(size=(rank, n)) / rank
    kind = "square" if m == n else "wide" if m < n else "tall"
    return listed(f"rank-deficient, {kind}", T, T @ numbers.uniform(-0.2, 1.2, n) + 0.05 * numbers.normal(size=m))


def zero_rows_and_columns() -> HardCase:
    """Unlit camera pixels whose target is bright, and projector pixels that light nothing."""
    numbers = rng(1)
    T = np.zeros((9, 7))
    T[np.ix_([1, 3, 4, 6, 8], [0, 2, 3, 6])] = numbers.uniform(0.1, 1, (5, 4))
    return listed("zero rows and columns", T, numbers.uniform(0.2, 0.8, 9))


def one_entry_clusters() -> HardCase:
    """Sixty clusters of one camera pixel and one projector pixel; p = b / T."""
    numbers = rng(2)
    weights = numbers.uniform(0.05, 1, 60)
    return listed("one-entry clusters", np.diag(weights), weights * numbers.uniform(0, 1, 60))


def graded_weights() -> HardCase:
    """Weights from 1e-7 to 1e3 in one cluster: condition 1e10 from scale alone; b is reachable."""
    numbers = rng(3)
    scale = np.logspace(3, -7, 12)
    T = np.eye(16, 12) * scale + 0.2 * np.eye(16, 12, -1) * scale + 0.1 * np.eye(16, 12, -4) * scale
    return listed("weights 1e-7 to 1e3", T, T @ numbers.uniform(0.1, 0.9, 12))


def denormal_weights() -> HardCase:
    """Weights that are denormal in float32, the type in which T is stored; b is reachable."""
    case = defocused_wall(1e2)
    T = Csr(1e-40 * case.T.astype(np.float64))
    T.data = T.data.astype(np.float32).astype(np.float64)
    T.eliminate_zeros()
    return replace(case, name="denormal weights", T=T, target=T @ rng(4).uniform(size=T.shape[1]))


# Walls


def defocused_wall(condition: float) -> HardCase:
    """White wall out of focus: the width of the Gaussian gives T this condition number.

    b is the light of a photograph on the projector, with 1 % noise.

    T = B_y ⊗ B_x, so its condition number is the product of the factors' numbers. The product is exact where an SVD of
    T fails.
    """
    T = Csr(np.kron(*_factors(defocus(condition))))
    photograph = typical_pictures(WALL_PROJECTOR)[0].ravel()
    target = T @ photograph + NOISE * rng(6).normal(size=T.shape[0])
    return HardCase(f"wall, condition {condition:.0e}", T, target, WALL_CAMERA, WALL_PROJECTOR)


def defocus(condition: float) -> float:
    """Standard deviation of the Gaussian, in projector pixels, for a wall of this condition number."""

    def excess(sigma: float) -> float:
        return float(sum(np.log10(np.linalg.cond(B)) for B in _factors(sigma)) - np.log10(condition))

    return float(brentq(excess, 0.3, 3.0, xtol=1e-6))


def _factors(sigma: float) -> tuple[FloatArray, FloatArray]:
    y, x = (_blur(*sizes, sigma) for sizes in _sides())
    return y, x


def _sides() -> Iterator[tuple[int, int]]:
    """Camera and projector pixels, first vertically, then horizontally."""
    return zip(WALL_CAMERA, WALL_PROJECTOR, strict=True)


def _blur(camera: int, projector: int, sigma: float, moved: float = 0.0) -> FloatArray:
    """Blur along one axis, (camera, projector), with rows that sum to 1.

    moved : shift in projector pixels.
    """
    x, u = (np.arange(camera) + 0.5) * projector / camera, np.arange(projector) + 0.5 + moved
    B = np.exp(-((x[:, None] - u) ** 2) / (2 * sigma**2))
    return np.asarray(B / B.sum(axis=1, keepdims=True))


def large_cluster() -> HardCase:
    """One textured cluster of 2048 projector pixels, slightly out of focus; b is reachable."""
    T = Csr(blurred_transport(rng(7), LARGE_CAMERA, LARGE_PROJECTOR, 0.5).astype(np.float64))
    target = T @ rng(8).uniform(size=T.shape[1])
    return HardCase("cluster of 2048", T, target, LARGE_CAMERA, LARGE_PROJECTOR)


def noise_floor() -> HardCase:
    """Half of the wall has a ten-thousandth of the light, measured with noise as large as this light."""
    wall = defocused_wall(1e2)
    bright = np.where(np.arange(wall.T.shape[1]) % WALL_PROJECTOR[1] < WALL_PROJECTOR[1] // 2, 1.0, 1e-4)
    truth = wall.dense * bright
    measured = truth + 1e-4 * np.abs(rng(9).normal(size=truth.shape)) * (truth > 0)
    return replace(wall, name="noise floor", T=Csr(measured), truth=Csr(truth))


def capture_noise(share: float, seed: int = 0) -> HardCase:
    """T with independent noise per entry, relative to the entry; the camera sees through the true T."""
    wall = defocused_wall(1e4)
    measured = wall.T.copy()
    measured.data *= np.maximum(1 + share * rng(100 + seed).normal(size=measured.data.size), 0)
    return replace(wall, name=f"capture noise {share:.0%}", T=measured, truth=wall.T)


def misaligned(pixels: float) -> HardCase:
    """Wall that moved horizontally by `pixels` projector pixels after T was measured."""
    wall = defocused_wall(1e4)
    sigma = defocus(1e4)
    moved = np.kron(*(_blur(*sizes, sigma, by) for sizes, by in zip(_sides(), (0.0, pixels), strict=True)))
    return replace(wall, name=f"misaligned by {pixels:g} pixels", truth=Csr(moved))


def far_light(share: float) -> HardCase:
    """Wall slightly out of focus. Far light, `share` times as bright as near light, reaches all camera pixels."""
    wall = defocused_wall(1e2)
    leaves, arrives = rng(13).uniform(0.8, 1.2, wall.T.shape[0]), rng(14).uniform(0.8, 1.2, wall.T.shape[1])
    arrives *= share / wall.T.shape[1]
    T = Csr(wall.dense + leaves[:, None] * arrives)
    target = (1 + share) * wall.target
    return replace(wall, name=f"far light, {share:g} times the near", T=T, target=target, far=_smooth(leaves, arrives))


def far_light_and_dark_paint(share: float) -> HardCase:
    """Wall in focus with a quarter painted nearly black; the target there is as bright as elsewhere.

    An unclamped drive exceeds white there by far, so its far light, on which a method may rely, is too bright
    everywhere.
    """
    wall = defocused_wall(1e1)
    paint = np.where(np.arange(wall.camera[1]) < 3 * wall.camera[1] // 4, 1.0, 0.02)
    dense = wall.dense * np.tile(paint, wall.camera[0])[:, None]
    arrives = np.full(wall.T.shape[1], share / wall.T.shape[1])
    far = _smooth(np.ones(wall.T.shape[0]), arrives)
    target = wall.target + share * float(np.mean(wall.target))
    T = Csr(dense + written_out(far))
    return replace(wall, name=f"dark paint, far light {share:g}", T=T, target=target, far=far)


def _smooth(leaves: FloatArray, arrives: FloatArray) -> FarLight:
    """Far light of one cell.

    leaves : (camera pixels,).
    arrives : (projector pixels,).
    """
    return far_light_of((Csr(arrives[None]),) * 3, np.ones((3, 1, 1)), (Csr(leaves[:, None]),) * 3)


def two_projectors(apart: float) -> HardCase:
    """Two projectors light one wall, shifted by a fraction of a pixel: their drives can cancel each other."""
    wall, sigma = defocused_wall(1e2), defocus(1e2)
    other = np.kron(*(_blur(*sizes, sigma, by) for sizes, by in zip(_sides(), (0.0, apart), strict=True)))
    pictures = [dense.reshape(-1, *WALL_PROJECTOR) for dense in (wall.dense, other)]
    T = Csr(0.5 * np.concatenate(pictures, axis=2).reshape(wall.T.shape[0], -1))
    projector = WALL_PROJECTOR[0], 2 * WALL_PROJECTOR[1]
    return replace(wall, name=f"two projectors, {apart:g} pixels apart", T=T, projector=projector)


def targets() -> list[HardCase]:
    """Several pictures on a wall of condition 1e4, and an ambient light brighter than most of a picture."""
    wall = defocused_wall(1e4)
    y, x = np.mgrid[: WALL_CAMERA[0], : WALL_CAMERA[1]]
    random = rng(10).uniform(size=y.shape)
    pictures = {
        "black": 0.0 * y,
        "white": 1.0 + 0.0 * y,
        "one pixel": 1.0 * ((y == 7) & (x == 9)),
        "checkerboard": 1.0 * ((y + x) % 2),
        "random": random,
        "ambient above": random - 0.7,
    }
    return [replace(wall, name=f"target {name}", target=picture.ravel()) for name, picture in pictures.items()]


def rescaled(case: HardCase, factor: float) -> HardCase:
    """Scale T and b to another unit."""
    truth = None if case.truth is None else Csr(factor * case.truth)
    name = f"{case.name}, T × {factor:.0e}"
    return replace(case, name=name, T=Csr(factor * case.T), target=factor * case.target, truth=truth)


def permuted(case: HardCase) -> tuple[HardCase, NDArray[np.int64]]:
    """Permute camera and projector pixels; the new case's p is p[order] of the old case, with the returned order."""
    rows, columns = rng(11).permutation(case.T.shape[0]), rng(12).permutation(case.T.shape[1])
    T = Csr(case.T[rows][:, columns])
    return replace(case, name=f"{case.name}, permuted", T=T, target=case.target[rows]), columns


def all_cases() -> Iterator[HardCase]:
    yield conflicting_rows()
    yield from (parallel_columns(gap) for gap in (0.0, 2e-8, 2e-14))
    yield from (rank_deficient(shape) for shape in ((12, 12), (9, 15), (20, 8)))
    yield zero_rows_and_columns()
    yield one_entry_clusters()
    yield large_cluster()
    yield graded_weights()
    yield denormal_weights()
    yield noise_floor()
    yield from (capture_noise(share) for share in (0.01, 0.05))
    yield from (misaligned(pixels) for pixels in (0.25, 1.0))
    yield from (far_light(share) for share in (1.0, 10.0))
    yield far_light_and_dark_paint(0.3)
    yield two_projectors(0.1)
    yield from targets()
    wall = defocused_wall(1e4)
    yield from (rescaled(wall, factor) for factor in (1e-6, 1e6))
    yield permuted(wall)[0]


# Methods


def by_solver(name: str, case: HardCase) -> Apply:
    return lambda b: solve(name, linear_system(case.T, b)).unclamped


def by_map(damping: float | None, max_cluster: int | None, case: HardCase) -> Apply:
    largest = None if max_cluster is None else min(max_cluster, case.T.shape[1])
    T_pinv = channels(inverse_of(case, InverseOptions(damping, KEEP_ALL, largest)).T_pinv)[1]
    return lambda b: np.asarray(T_pinv @ b)


def by_split(damping: float | None, passes: int, case: HardCase) -> Apply:
    """Invert the near light after subtracting the far light of the drive.

    passes : 0 subtracts the far light of the unclamped drive; n repeats it n times with the clamped drive.
    """
    if case.far is None:
        return by_map(damping, None, case)
    near = replace(case, T=Csr(np.maximum(case.dense - written_out(case.far), 0)))
    S_pinv = inverse_of(near, InverseOptions(damping, KEEP_ALL)).T_pinv
    undo = undo_far_light(case.far, S_pinv)

    def drive(b: FloatArray) -> FloatArray:
        wanted = np.repeat(b[:, None], 3, axis=1)
        p = S_pinv.apply(wanted - undo.apply(wanted))
        for _ in range(passes):
            p = S_pinv.apply(wanted - case.far.apply(np.clip(p, 0, 1)))
        return np.asarray(p[:, 1])

    return drive


def written_out(far: FarLight) -> FloatArray:
    """Returns U M D of one channel, (camera pixels, projector pixels)."""
    return np.asarray(channels(far.scatter)[1] @ far.mix.matrices[1] @ channels(far.gather)[1].toarray())


def inverse_of(case: HardCase, options: InverseOptions) -> Inverse:
    """Inverse of a grey room with three equal channels."""
    flood = (case.T @ np.ones(case.T.shape[1])).reshape(case.camera)
    white = reachable_white(np.repeat(flood[..., None], 3, axis=2), flood > 0)
    mask = np.ones(case.camera, bool)
    reach = np.full((mask.size, 3), max(white, float(np.abs(case.target).max())))
    return invert_near_light(stacked((case.T,) * 3), mask, case.projector, reach, white, options)


def refining(case: HardCase) -> Callable[[int], Apply]:
    """Returns a function of the number of steps: the player's default drive of a room with this T."""
    dark = max(0.0, -float(case.target.min()))  # ambient light is added, because a camera picture is not negative
    grey, mask = (case.T,) * 3, np.ones(case.camera, bool)
    room = cl.Room.from_matrices(
        *grey, camera=case.camera, projector=case.projector, ambient=dark, mask=mask, response="linear"
    )
    maps = cl.build_maps(room)

    def refined(steps: int, b: FloatArray) -> FloatArray:
        picture = np.repeat(np.maximum(b + dark, 0).reshape(*case.camera, 1), 3, axis=2) / maps.white
        with cl.Renderer(room, maps, backend="cpu") as renderer:
            return np.asarray(renderer.render(picture, refine=steps)[..., 1], np.float64).ravel()

    return lambda steps: partial(refined, steps)


def by_refinement(steps: int, case: HardCase) -> Apply:
    return refining(case)(steps)


REFINED: dict[str, Callable[[HardCase], Apply]] = {f"refined {n}": partial(by_refinement, n) for n in (4, 64)}
METHODS: dict[str, Callable[[HardCase], Apply]] = {
    **{name: partial(by_solver, name) for name in SOLVERS},
    "map none": partial(by_map, 0.0, None),
    "map 0.01": partial(by_map, 0.01, None),
    "map 0.1": partial(by_map, 0.1, None),
    "map auto": partial(by_map, None, None),
    "map auto cut": partial(by_map, None, CUT),
}
SPLIT: dict[str, Callable[[HardCase], Apply]] = {  # split: far light is handled separately; thesis: one T, decomposed
    "thesis": partial(by_map, 0.0, CUT),
    "split none": partial(by_split, 0.0, 0),
    "split none, clamped": partial(by_split, 0.0, 2),
    "split 0.1": partial(by_split, 0.1, 0),
    "split 0.1, clamped": partial(by_split, 0.1, 2),
}
