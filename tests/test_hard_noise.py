"""Noise in ill-conditioned systems, against proven bounds.

With T = U Σ Vᵀ and T⁺ = V (Σ/(Σ² + λ²)) Uᵀ (Hansen 1998, 4.2):

- ‖T⁺‖ ≤ 1/(2λ), because σ/(σ² + λ²) ≤ 1/(2λ). This bounds the noise in b that reaches the drive, for any T.
- b = T p gives ‖T T⁺ b − b‖ ≤ λ/2 ‖p‖, because λ²σ/(σ² + λ²) ≤ λ/2. This bounds the loss of the picture, for any T.
- Dropping singular values up to a cut-off s gives ‖T⁺‖ ≤ 1/s and ‖T T⁺ b − b‖ ≤ s ‖p‖.
- The clamp to 0..1 never increases the distance of two drives.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, nnls

from counterlight.tools.inverse.bidiagonal import largest_singular_value
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.transport.transport import channels
from tests import hard_systems as hard
from tests.hard_systems import CONDITIONS, KEEP_ALL
from tests.one_channel import linear_system, relative_gap, solve
from tests.studies import hard_cases
from tests.test_hard_cases import MAPS, SQUARES, WALLS, cut_off, drive, matrix_of, unclamped

FloatArray = NDArray[np.float64]
SEEDS = range(8)


@cache
def map_of_wall(condition: float, damping: float | None) -> tuple[FloatArray, float]:
    """Returns dense T⁺ of a wall, and its λ; neither depends on the target."""
    return matrix_of(WALLS[condition], damping)


def filtered_inverse(T: FloatArray, damping: float) -> FloatArray:
    """Returns V (Σ/(Σ² + λ²)) Uᵀ from the singular value decomposition, exact where normal equations are not."""
    U, sigma, Vt = np.linalg.svd(T, full_matrices=False)
    return np.asarray((Vt.T * (sigma / (sigma**2 + damping**2))) @ U.T)


@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("fraction", [0.01, 0.1, None])
def test_a_damped_map_amplifies_noise_by_at_most_1_over_2_lambda(condition: float, fraction: float | None) -> None:
    T_pinv, damping = map_of_wall(condition, fraction)
    assert np.linalg.norm(T_pinv, 2) <= (1 + 1e-5) / (2 * damping)  # float32 weights


@pytest.mark.parametrize("condition", CONDITIONS)
def test_a_plain_map_amplifies_noise_by_at_most_the_cut_off(condition: float) -> None:
    T_pinv, _ = map_of_wall(condition, 0.0)
    largest = np.linalg.norm(T_pinv, 2)
    # float32 weights as large as the cut-off allows
    assert largest <= 1.01 / cut_off(WALLS[condition].dense)
    if 1 / condition > cut_off(WALLS[condition].dense):
        assert largest * WALLS[condition].largest_singular_value == pytest.approx(condition, rel=0.01)


@pytest.mark.parametrize("condition", CONDITIONS)
def test_the_svd_amplifies_noise_by_at_most_the_cut_off(condition: float) -> None:
    case = WALLS[condition]
    assert hard_cases.measure(case, "svd").amplification <= case.largest_singular_value * 1.01 / cut_off(case.dense)


@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("method", [*SQUARES, *MAPS])
def test_what_is_within_reach_is_lost_by_no_more_than_the_method_states(condition: float, method: str) -> None:
    """The loss for b = T p, unclamped, is at most λ/2 ‖p‖ if damped, or the cut-off times ‖p‖ if truncated."""
    p = hard.rng(5).uniform(size=WALLS[condition].T.shape[1])
    case = replace(WALLS[condition], target=WALLS[condition].T @ p)
    residual = np.linalg.norm(case.T @ unclamped(case, method) - case.target)
    if method.startswith("map 0"):
        _, damping = map_of_wall(condition, MAPS[method])
        assert residual <= (damping / 2 + 1e-5) * np.linalg.norm(p)
    elif method in SQUARES:
        rounding = 1e-3 if "map" in method else 1e-12  # float32 weights of up to 1 / cut-off, of both signs
        assert residual <= (cut_off(case.dense) + rounding) * np.linalg.norm(p)


@pytest.mark.parametrize("condition", [1e2, 1e8, 1e14])
def test_least_squares_are_as_exact_as_numpys(condition: float) -> None:
    """The residual of an unclamped solution equals numpy's least squares with the same cut-off, or is smaller."""
    case = WALLS[condition]
    p = np.linalg.lstsq(case.dense, case.target, rcond=cut_off(case.dense) / case.largest_singular_value)[0]
    best = np.linalg.norm(case.dense @ p - case.target)
    assert np.linalg.norm(case.dense @ unclamped(case, "qr") - case.target) <= best * (1 + 1e-6)
    assert np.linalg.norm(case.dense @ unclamped(case, "svd") - case.target) == pytest.approx(best, rel=1e-6)
    _, residual = nnls(case.dense, case.target, maxiter=10_000)
    assert np.linalg.norm(case.dense @ unclamped(case, "nnls") - case.target) <= residual * (1 + 1e-6)


@pytest.mark.parametrize("condition", [1e2, 1e8])
def test_the_box_certificate_holds_however_ill_conditioned(condition: float) -> None:
    case = WALLS[condition]
    system = linear_system(case.T, case.target)
    found = solve("box", system).drive
    objective = 0.5 * system.squared_error(found)
    gap = relative_gap(system, found) * objective
    # Any drive within 0..1 improves by at most the gap; scipy's solution may be better or worse.
    assert objective - lsq_linear(case.dense, case.target, (0, 1), method="trf", tol=1e-12).cost <= gap
    assert np.sqrt(2 * gap) <= 1e-3 * np.linalg.norm(case.floodlight)  # the gap is 60 dB below the floodlit room


@pytest.mark.parametrize("share", [0.01, 0.05])
@pytest.mark.parametrize("fraction", [0.01, 0.1])
def test_capture_noise_reaches_the_drive_within_the_proven_bound(share: float, fraction: float) -> None:
    """With T' = T + E instead of T, at equal λ: ‖p' − p‖ ≤ ‖E‖ (‖p‖/(2λ) + ‖r‖/λ²), r = b − T p.

    The bound follows from (T'ᵀT' + λ²)(p' − p) = Eᵀr − T'ᵀE p. The factors in `stated` are limits for these seeds,
    relative to the noise's share: RMS of the drive and of the camera picture, both after the clamp.
    """
    stated = {0.01: (12.0, 1.5), 0.1: (0.7, 0.15)}[fraction]
    wall = WALLS[1e4]
    damping = fraction * largest_singular_value(wall.T)
    p = filtered_inverse(wall.dense, damping) @ wall.target
    r = np.linalg.norm(wall.target - wall.dense @ p)
    for seed in SEEDS:
        noisy = hard.capture_noise(share, seed)
        options = InverseOptions(damping / largest_singular_value(noisy.T), KEEP_ALL)
        q = channels(hard.inverse_of(noisy, options).T_pinv)[1] @ noisy.target
        E = np.linalg.norm(noisy.dense - wall.dense, 2)
        assert np.linalg.norm(q - p) <= E * (np.linalg.norm(p) / (2 * damping) + r / damping**2) + 1e-4
        moved = np.clip(q, 0, 1) - np.clip(p, 0, 1)
        assert np.sqrt(np.mean(moved**2)) <= stated[0] * share
        assert np.linalg.norm(wall.T @ moved) <= stated[1] * share * np.linalg.norm(wall.floodlight)


@pytest.mark.parametrize("fraction", [0.01, 0.1])
def test_noise_in_the_picture_reaches_the_drive_within_the_bound(fraction: float) -> None:
    T_pinv, damping = map_of_wall(1e8, fraction)
    clean = T_pinv @ WALLS[1e8].target
    for seed in SEEDS:
        for share in (0.01, 0.05):
            noise = share * hard.rng(300 + seed).normal(size=T_pinv.shape[1])
            moved = np.clip(T_pinv @ (WALLS[1e8].target + noise), 0, 1) - np.clip(clean, 0, 1)
            assert np.linalg.norm(moved) <= np.linalg.norm(noise) * (1 + 1e-5) / (2 * damping)


def test_at_the_noise_floor_the_dark_half_costs_the_bright_half_nothing() -> None:
    case = hard.noise_floor()
    bright = np.asarray(case.seen_by @ np.ones(case.T.shape[1])) > 0.5
    alone = replace(case, truth=None, T=case.truth)
    for method in ("map 0.1", "box"):
        error, reference = (
            np.linalg.norm((c.seen_by @ drive(c, method) - c.target)[bright]) / np.linalg.norm(c.floodlight)
            for c in (case, alone)
        )
        assert error <= reference + 1e-3  # noise of 1e-4 of the light


@pytest.mark.parametrize("share", [0.01, 0.05])
def test_the_plain_inverse_leaves_out_what_is_noise(share: float) -> None:
    """T of rank 5, measured with noise, has full rank; the inverse with stated noise has rank 5."""
    for seed in SEEDS:
        numbers = np.random.default_rng(seed)
        T = numbers.uniform(0.2, 1, (40, 5)) @ numbers.uniform(0.2, 1, (5, 30))
        case = hard.listed("noisy", T * (1 + share * numbers.normal(size=T.shape)), np.ones(40))
        aware, unaware = (
            channels(hard.inverse_of(case, InverseOptions(0.0, KEEP_ALL, noise=noise)).T_pinv)[1].toarray()
            for noise in (share, 0.0)
        )
        assert np.linalg.matrix_rank(aware, tol=1e-4 * np.linalg.norm(aware, 2)) <= 5
        assert np.linalg.norm(aware, 2) < np.linalg.norm(unaware, 2)
