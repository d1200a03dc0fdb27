"""Hard cases with known answers; test_hard_noise.py covers the bounds for noise."""

from fractions import Fraction

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, nnls
from scipy.sparse.linalg import lsmr

from counterlight.errors import InputError
from counterlight.tools.clusters.components import NonFiniteError
from counterlight.tools.inverse.bidiagonal import largest_singular_value
from counterlight.tools.inverse.clustered import damped_inverse
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.solve.box import TOLERANCE
from counterlight.tools.transport.transport import channels
from tests import hard_systems as hard
from tests.hard_systems import CONDITIONS, KEEP_ALL, METHODS, HardCase
from tests.one_channel import linear_system, relative_gap, solve
from tests.studies import hard_cases

FloatArray = NDArray[np.float64]
FLOAT32_EPS = float(np.finfo(np.float32).eps)
SQUARES = ["qr", "svd", "map none"]  # least squares of minimum norm
BOUNDED = ["nnls", "box"]
MAPS = {"map 0.01": 0.01, "map 0.1": 0.1}
WALLS = {condition: hard.defocused_wall(condition) for condition in CONDITIONS}


def unclamped(case: HardCase, method: str) -> FloatArray:
    return METHODS[method](case)(case.target)


def drive(case: HardCase, method: str) -> FloatArray:
    return np.clip(unclamped(case, method), 0, 1)


def cut_off(T: FloatArray) -> float:
    """Singular values up to this limit are noise, because T is stored in float32."""
    return float(np.linalg.norm(T, 2)) * FLOAT32_EPS * max(T.shape)


def matrix_of(case: HardCase, damping: float | None) -> tuple[FloatArray, float]:
    """Returns dense T⁺ of the green channel, and its λ."""
    inverse = hard.inverse_of(case, InverseOptions(damping, KEEP_ALL))
    return channels(inverse.T_pinv)[1].toarray(), inverse.damping * largest_singular_value(case.T)


# Known answers


@pytest.mark.parametrize("method", [*SQUARES, *BOUNDED])
def test_duplicate_rows_with_conflicting_targets_get_their_mean(method: str) -> None:
    np.testing.assert_allclose(drive(hard.conflicting_rows(), method), [0.4 / 0.8, 0.25 / 0.5], atol=1e-6)


def test_damping_conflicting_rows_is_the_ridge_formula() -> None:
    case = hard.conflicting_rows()
    T_pinv, damping = matrix_of(case, 0.1)
    expected = [0.8 * (0.2 + 0.6) / (2 * 0.8**2 + damping**2), 0.5 * 0.25 / (0.5**2 + damping**2)]
    np.testing.assert_allclose(T_pinv @ case.target, expected, rtol=1e-6)  # float32 weights


@pytest.mark.parametrize("method", SQUARES)
def test_exactly_parallel_columns_share_the_light(method: str) -> None:
    np.testing.assert_allclose(unclamped(hard.parallel_columns(0), method), [0.45, 0.45], atol=1e-6)


@pytest.mark.parametrize("method", BOUNDED)
def test_exactly_parallel_columns_are_shared_in_some_way(method: str) -> None:
    p = drive(hard.parallel_columns(0), method)
    assert p.sum() == pytest.approx(0.9, abs=1e-4)  # the gap of the box optimum
    assert p.min() >= 0


@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("fraction", [0.001, 0.01, 0.1])
def test_damped_parallel_columns_match_exact_arithmetic(condition: float, fraction: float) -> None:
    """The reference is Cramer's rule for the normal equations of two columns, in rational numbers."""
    case = hard.parallel_columns(2 / condition)
    damping = fraction * case.largest_singular_value
    (u, v), b = [[Fraction(x) for x in column] for column in case.dense.T], [Fraction(x) for x in case.target]
    product = lambda x, y: sum(a * c for a, c in zip(x, y, strict=True))  # noqa: E731
    uu, vv, uv, squared = product(u, u), product(v, v), product(u, v), Fraction(damping) ** 2
    determinant = (uu + squared) * (vv + squared) - uv**2
    exact = [((vv + squared) * product(u, b) - uv * product(v, b)) / determinant]
    exact.append(((uu + squared) * product(v, b) - uv * product(u, b)) / determinant)
    found = damped_inverse(case.dense[None], np.array([damping]))[0] @ case.target
    # normal equations of condition 1 / fraction², in float64
    np.testing.assert_allclose(found, [float(x) for x in exact], rtol=10 * 2.2e-16 / fraction**2)


@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("method", ["qr", "svd"])
def test_nearly_parallel_columns_are_distinguished_or_share_the_light(condition: float, method: str) -> None:
    """Below the cut-off of float32, both columns count as one; above it, p = (0.3, 0.6) is found."""
    case = hard.parallel_columns(2 / condition)
    expected = [0.3, 0.6] if 1 / condition > 4 * FLOAT32_EPS else [0.45, 0.45]
    np.testing.assert_allclose(unclamped(case, method), expected, atol=10 * min(condition, 1e8) * 2.2e-16)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("condition", CONDITIONS)
def test_nearly_parallel_columns_never_spoil_what_the_camera_sees(condition: float, method: str) -> None:
    """Together, the pixels must show 0.9 times a; λ/2 ‖p‖ and float32 weights of size `condition` are allowed."""
    case = hard.parallel_columns(2 / condition)
    weights = min(condition, 1 / (4 * FLOAT32_EPS)) * FLOAT32_EPS if method == "map none" else 1e-5
    gap = 4e-5 if method == "box" else 0.0  # the solver's steps end at an error 90 dB below the floodlit room
    damped = {"map 0.01": 0.01 / 2, "map 0.1": 0.1 / 2}.get(method, 0.4 / 2 if "auto" in method else 0.0)
    direct = 1 / condition if method == "direct" else 0.0  # direct mapping gives both columns' light to one pixel
    assert case.error(unclamped(case, method)) <= damped + weights + gap + direct


@pytest.mark.parametrize("shape", [(12, 12), (9, 15), (20, 8)])
def test_rank_deficient_clusters_give_the_least_squares_of_minimum_norm(shape: tuple[int, int]) -> None:
    case = hard.rank_deficient(shape)
    expected = np.linalg.pinv(case.dense, rcond=1e-9) @ case.target
    assert np.linalg.matrix_rank(case.dense, tol=1e-9) == min(shape) - 2
    for method in SQUARES:
        np.testing.assert_allclose(unclamped(case, method), expected, rtol=2e-5, atol=2e-5)  # float32 weights ≤ 1e3


@pytest.mark.parametrize("shape", [(12, 12), (9, 15), (20, 8)])
@pytest.mark.parametrize("fraction", [0.01, 0.1])
def test_rank_deficient_clusters_damped_solve_the_augmented_system(shape: tuple[int, int], fraction: float) -> None:
    """The reference is numpy's least squares of one system [T; λ I] p = [b; 0], for min ‖T p − b‖² + λ² ‖p‖²."""
    case = hard.rank_deficient(shape)
    T_pinv, damping = matrix_of(case, fraction)
    n = case.T.shape[1]
    stacked = np.vstack([case.dense, damping * np.eye(n)])
    expected = np.linalg.lstsq(stacked, np.concatenate([case.target, np.zeros(n)]), rcond=None)[0]
    np.testing.assert_allclose(T_pinv @ case.target, expected, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("shape", [(12, 12), (9, 15), (20, 8)])
def test_rank_deficient_clusters_within_bounds_are_scipys(shape: tuple[int, int]) -> None:
    """The minimiser is not unique, but its error is."""
    case = hard.rank_deficient(shape)
    system = linear_system(case.T, case.target)
    best = 2 * lsq_linear(case.dense, case.target, (0, 1), method="bvls", tol=1e-12).cost
    assert system.squared_error(solve("box", system).drive) <= best * (1 + 2 * TOLERANCE)
    _, residual = nnls(case.dense, case.target)
    assert np.sqrt(system.squared_error(solve("nnls", system).unclamped)) <= residual * (1 + 1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_zero_rows_and_columns_change_nothing_for_the_others(method: str) -> None:
    case = hard.zero_rows_and_columns()
    rows, columns = np.flatnonzero(case.dense.any(axis=1)), np.flatnonzero(case.dense.any(axis=0))
    compact = hard.listed("compact", case.dense[np.ix_(rows, columns)], case.target[rows])
    p = unclamped(case, method)
    assert not p[np.setdiff1d(np.arange(p.size), columns)].any()
    if "auto" not in method:  # λ is chosen on pictures of the camera's size, which differs
        tolerance = 5e-3 if method == "box" else 1e-6  # the box's gap refers to a target with the dark rows
        np.testing.assert_allclose(p[columns], unclamped(compact, method), rtol=1e-6, atol=tolerance)


@pytest.mark.parametrize("method", METHODS)
def test_one_entry_clusters_are_divisions(method: str) -> None:
    case = hard.one_entry_clusters()
    weights = case.T.diagonal()
    damping = MAPS.get(method, 0.0) * weights.max()
    if "auto" not in method:
        expected = weights * case.target / (weights**2 + damping**2)
        # Power iteration may underestimate σ₁ by 1 %, which enters λ² twice; float32 weights; the box optimum's gap.
        np.testing.assert_allclose(unclamped(case, method), expected, rtol=0.02 if damping else 1e-6, atol=1e-4)


# Weights of all sizes


@pytest.mark.parametrize("method", ["svd", "qr", "map none"])
def test_weights_from_1e_7_to_1e3_lose_no_more_than_the_cut_off(method: str) -> None:
    case = hard.graded_weights()
    p = unclamped(case, method)
    allowed = cut_off(case.dense) * np.sqrt(case.T.shape[1])  # ‖p‖ ≤ √n for the p in 0..1 that gave b
    rounding = FLOAT32_EPS * np.linalg.norm(case.target) * 30  # rounding of float32 weights, both ways through T
    assert np.linalg.norm(case.T @ p - case.target) <= allowed + (rounding if "map" in method else 0)
    assert np.abs(p).max() <= np.linalg.norm(case.target) / cut_off(case.dense)


def test_weights_from_1e_7_to_1e3_within_bounds() -> None:
    """b is reachable: nnls finds the exact drive, and box comes within the gap of its certificate."""
    case = hard.graded_weights()
    p = hard.rng(3).uniform(0.1, 0.9, 12)
    np.testing.assert_allclose(unclamped(case, "nnls"), p, atol=1e-4)  # condition 1e10 in float64
    system = linear_system(case.T, case.target)
    assert relative_gap(system, solve("box", system).drive) <= TOLERANCE


@pytest.mark.parametrize("method", ["direct", "qr", "svd", *BOUNDED])
def test_denormal_weights_are_solved_like_any_others(method: str) -> None:
    """1e-40 times a wall, denormal in float32, gives the drive of the wall with the same rounded weights."""
    case = hard.denormal_weights()
    ordinary = hard.rescaled(case, 1e40)
    np.testing.assert_allclose(drive(case, method), drive(ordinary, method), atol=1e-6)


@pytest.mark.parametrize("method", [name for name in METHODS if "map" in name])
def test_a_map_beyond_float32_is_refused(method: str) -> None:
    """The weights of T⁺ are about 1e40, beyond float32."""
    with pytest.raises(InputError, match=r"projector pixel.*beyond float32"):
        METHODS[method](hard.denormal_weights())


@pytest.mark.parametrize("method", METHODS)
def test_another_unit_of_radiance_changes_no_drive(method: str) -> None:
    for case in (WALLS[1e4], hard.rank_deficient((12, 12))):
        expected = drive(case, method)
        tolerance = 20 * FLOAT32_EPS * hard_cases.measure(case, method).amplification if "map" in method else 1e-6
        for factor in (1e-6, 1e6):
            np.testing.assert_allclose(drive(hard.rescaled(case, factor), method), expected, atol=max(tolerance, 1e-6))


@pytest.mark.parametrize("method", [name for name in METHODS if "auto" not in name])
def test_another_order_of_pixels_changes_no_drive(method: str) -> None:
    """`auto` is excluded: its pictures and the decomposition's neighbourhoods depend on the order of pixels."""
    case = WALLS[1e4]
    other, order = hard.permuted(case)
    p, q = drive(case, method), drive(other, method)
    tolerance = {"box": None, "map none": 1e-2}.get(method, 1e-6)  # 1e4 times the rounding of float32 weights
    if tolerance is None:  # within the gap, the drive is not unique, but its error is
        assert other.error(q) == pytest.approx(case.error(p), rel=TOLERANCE)
    else:
        np.testing.assert_allclose(q, p[order], atol=tolerance)


# Targets

TARGETS = {case.name.removeprefix("target "): case for case in hard.targets()}


@pytest.mark.parametrize("method", METHODS)
def test_a_black_target_asks_for_black(method: str) -> None:
    assert drive(TARGETS["black"], method).max() <= 1e-12  # remainder of the start after all gradient steps


@pytest.mark.parametrize("method", METHODS)
def test_a_white_target_asks_for_white(method: str) -> None:
    """T·1 is reachable: p = 1, minus the effect of damping."""
    case = TARGETS["white"]
    damped = 0.4 if "auto" in method else MAPS.get(method, 0.0)
    decomposed = 0.01 if "cut" in method else 0.0  # the decomposition keeps T·1, not the blur
    assert case.error(unclamped(case, method)) <= damped / 2 + decomposed + 1e-3  # float32 weights of condition 1e4


@pytest.mark.parametrize("name", ["one pixel", "checkerboard", "random", "ambient above"])
def test_out_of_reach_no_method_beats_the_box_optimum(name: str) -> None:
    """Damping avoids the errors of a plain inverse with the clamp."""
    case = TARGETS[name]
    errors = {method: case.error(drive(case, method)) for method in METHODS}
    optimum = lsq_linear(case.dense, case.target, (0, 1), method="trf", tol=1e-12).x
    assert errors["box"] == pytest.approx(case.error(optimum), rel=TOLERANCE)
    assert min(errors.values()) >= errors["box"] * (1 - TOLERANCE)
    assert errors["map 0.1"] <= errors["map none"]


@pytest.mark.parametrize("method", BOUNDED)
def test_where_ambient_is_brighter_everywhere_the_projector_stays_black(method: str) -> None:
    """With b < 0 ≤ T p, the optimum is p = 0."""
    case = hard.replace(WALLS[1e4], target=np.full(WALLS[1e4].T.shape[0], -0.3))
    assert not drive(case, method).any()


# A cluster with too many pixels for a whole inverse


@pytest.fixture(scope="module")
def large() -> HardCase:
    return hard.large_cluster()


def test_one_cluster_of_thousands_is_inverted_through_windows(large: HardCase) -> None:
    """The reference is LSMR on the whole damped system; each row comes from one window's inverse, of at most 1/(2λ)."""
    inverse = hard.inverse_of(large, InverseOptions(0.1, KEEP_ALL))
    assert (inverse.clusters.count, inverse.windowed_clusters) == (1, 1)
    T_pinv, damping = channels(inverse.T_pinv)[1], 0.1 * largest_singular_value(large.T)
    whole = lsmr(large.T, large.target, damp=damping, atol=1e-12, btol=1e-12, maxiter=5000)[0]
    change = np.abs(np.clip(T_pinv @ large.target, 0, 1) - np.clip(whole, 0, 1))
    assert change.max() <= inverse.window_tolerance
    assert np.sqrt(T_pinv.multiply(T_pinv).sum(axis=1)).max() <= (1 + 1e-5) / (2 * damping)


@pytest.mark.parametrize("method", ["qr", "svd", *BOUNDED])
def test_one_cluster_of_thousands_is_solved(large: HardCase, method: str) -> None:
    assert large.error(unclamped(large, method)) <= 1e-4  # b is reachable; LSMR's and the gradient's tolerance


def test_one_cluster_of_thousands_has_no_plain_inverse(large: HardCase) -> None:
    with pytest.raises(InputError, match=r"cluster of 2048 projector pixels.*--regularize auto"):
        METHODS["map none"](large)


# No method returns a value that is not finite


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_transport_that_is_not_finite_is_refused_by_its_cluster(value: float) -> None:
    T = np.diag([0.5, 0.4, value, 0.6])
    for method in METHODS:
        with pytest.raises(InputError, match=r"cluster.*likely causes"):
            METHODS[method](hard.listed("broken", T, np.ones(4)))(np.ones(4))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_target_that_is_not_finite_is_refused_by_its_cluster(value: float) -> None:
    with pytest.raises(NonFiniteError, match=r"camera pixel 1 \(cluster 1 of 2.*likely causes"):
        linear_system(np.eye(2), np.array([0.5, value]))


@pytest.mark.parametrize("factor", [1e-200, 1e200])
@pytest.mark.parametrize("method", ["direct", "qr", "svd", *BOUNDED])
def test_weights_beyond_float32_are_solved_or_refused(factor: float, method: str) -> None:
    """The squares of these weights overflow or vanish in float64."""
    try:
        found = drive(hard.rescaled(WALLS[1e2], factor), method)
    except NonFiniteError:
        return
    np.testing.assert_allclose(found, drive(WALLS[1e2], method), atol=1e-2)


@pytest.mark.parametrize("fraction", [1e-5, 1e-7, 1e-9, 1e-12])
@pytest.mark.parametrize("name", ["ones", "square", "wide", "tall"])
def test_damping_too_small_to_matter_keeps_its_bound(name: str, fraction: float) -> None:
    """λ² vanishes next to σ₁² in float64, and T is rank-deficient; --regularize accepts any number from 0 to 1."""
    shapes = {"square": (12, 12), "wide": (9, 15), "tall": (20, 8)}
    T = np.ones((2, 2)) if name == "ones" else hard.rank_deficient(shapes[name]).dense
    damping = fraction * float(np.linalg.norm(T, 2))
    T_pinv = damped_inverse(T[None], np.array([damping]))[0]
    assert np.linalg.norm(T_pinv, 2) <= (1 + 1e-6) / (2 * damping)
    b = T @ np.full(T.shape[1], 0.5)
    assert np.linalg.norm(T @ T_pinv @ b - b) <= (damping / 2 + 1e-6 * np.linalg.norm(T)) * 0.5 * np.sqrt(T.shape[1])


@pytest.mark.parametrize("share", [0.1, 0.3, 1.0])
def test_far_light_of_a_drive_that_is_not_clamped_spoils_what_is_within_reach(share: float) -> None:
    """A plain inverse fails, with far light separate or inside T; the clamp, the thesis' cut or damping help."""
    case = hard.far_light_and_dark_paint(share)
    found = {name: case.error(np.clip(make(case)(case.target), 0, 1)) for name, make in hard.SPLIT.items()}
    best = case.error(drive(case, "box"))
    plain = found["split none"] - best
    # both methods have the same fixed point; float32 rounding
    assert case.error(drive(case, "map none")) - best == pytest.approx(plain, rel=0.05)
    assert found["split none, clamped"] - best < 0.5 * plain
    assert found["thesis"] - best < 0.2 * plain
    assert found["split 0.1"] - best < 0.2 * plain
    assert found["split 0.1, clamped"] == pytest.approx(
        found["split 0.1"], abs=1e-3
    )  # with damping, clamping cannot improve the result
