"""Choice of λ: one Krylov basis against a solver per λ, what the choice may depend on, and the noise of T."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import lsmr

from counterlight.tools.inverse.bidiagonal import Bidiagonal, Products, bidiagonalise, largest_singular_value
from counterlight.tools.inverse.clustered import damped_inverse
from counterlight.tools.inverse.damping import CANDIDATES, choose_damping
from counterlight.tools.inverse.near_light import InverseOptions, invert_near_light
from counterlight.tools.inverse.noise import noise_of_matrix
from counterlight.tools.transport.transport import Csr, channels, stacked
from tests.rooms import blurred_transport

CAMERA, PROJECTOR = (15, 19), (12, 16)
MASK = np.ones(CAMERA, bool)
SEEDS = range(12)


def basis(T: Csr, b: NDArray[np.float64], lambdas: NDArray[np.float64], steps: int, accuracy: float) -> Bidiagonal:
    return bidiagonalise(Products(T), b, lambdas, steps, accuracy)


def test_one_basis_gives_every_damped_solution_that_lsmr_gives(rng: np.random.Generator) -> None:
    T = blurred_transport(rng, CAMERA, PROJECTOR, 0.6)
    b = rng.uniform(size=T.shape[0])
    lambdas = largest_singular_value(T) * np.array(CANDIDATES)
    found = basis(T, b, lambdas, 200, 1e-9).damped(lambdas)
    for p, damp in zip(found.T, lambdas, strict=True):
        expected = lsmr(T.astype(np.float64), b, damp=damp, atol=1e-13, btol=1e-13, maxiter=5000)[0]
        # a float32 basis of about 100 terms
        np.testing.assert_allclose(p, expected, atol=3e-6 * np.abs(expected).max())


def test_its_error_bounds_hold_and_shrink(rng: np.random.Generator) -> None:
    T = blurred_transport(rng, CAMERA, PROJECTOR, 0.8)
    b = rng.uniform(size=T.shape[0])
    lambdas = largest_singular_value(T) * np.array(CANDIDATES)
    exact = damped_inverse(T.toarray().astype(float)[None], lambdas) @ b
    previous = np.full(lambdas.size, np.inf)
    for steps in (5, 20, 80):
        found = basis(T, b, lambdas, steps, 0.0)
        distance = np.sqrt(np.mean((found.damped(lambdas) - exact.T) ** 2, axis=0))
        assert np.all(distance <= found.errors(lambdas) + 1e-5)  # the basis is float32
        assert np.all(found.errors(lambdas) < previous)
        previous = found.errors(lambdas)


def test_it_stops_when_every_damping_is_accurate(rng: np.random.Generator) -> None:
    T = blurred_transport(rng, CAMERA, PROJECTOR, 0.8)
    b, lambdas = rng.uniform(size=T.shape[0]), np.array([0.3, 0.5])
    found = basis(T, b, lambdas, 500, 1e-4)
    assert found.below.size < 100
    assert found.errors(lambdas).max() <= 1e-4


def test_a_basis_ends_where_the_problem_ends() -> None:
    T = sparse.csr_array(sparse.diags_array(np.array([3.0, 2.0, 0.0])))
    lambdas = np.array([0.5])
    np.testing.assert_array_equal(basis(T, np.zeros(3), lambdas, 9, 0.0).damped(lambdas), np.zeros((3, 1)))
    np.testing.assert_array_equal(basis(T, np.array([0.0, 0, 1]), lambdas, 9, 0.0).damped(lambdas), np.zeros((3, 1)))
    found = basis(T, np.array([1.0, 1, 1]), lambdas, 9, 0.0).damped(lambdas)
    np.testing.assert_allclose(found[:, 0], [3 / 9.25, 2 / 4.25, 0], rtol=1e-6)  # σ / (σ² + λ²), float32


def test_largest_singular_value(rng: np.random.Generator) -> None:
    T = blurred_transport(rng, CAMERA, PROJECTOR, 0.7)
    exact = np.linalg.svd(T.toarray(), compute_uv=False)[0]
    assert largest_singular_value(T) == pytest.approx(exact, rel=0.01)  # twenty steps, close second value
    assert largest_singular_value(1e-6 * T) == pytest.approx(1e-6 * exact, rel=0.01)
    apart = sparse.csr_array(sparse.block_diag([T, 1.7 * T, 0.1 * T]))  # the strongest of many clusters
    assert largest_singular_value(apart) == pytest.approx(1.7 * exact, rel=0.01)
    assert largest_singular_value(sparse.csr_array((3, 4))) == 0


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_the_choice_of_damping_ignores_the_unit_of_light(rng: np.random.Generator, scale: float) -> None:
    T = blurred_transport(rng, CAMERA, PROJECTOR, 0.7)
    reference = choose_damping(T, 0.5, MASK)
    scaled = choose_damping(sparse.csr_array(T * np.float32(scale)), 0.5 * scale, MASK)
    assert scaled.damping == reference.damping
    assert set(scaled.errors) == set(CANDIDATES)


def test_direct_mapping_is_hardly_damped() -> None:
    T = sparse.csr_array(sparse.diags_array(np.linspace(0.05, 1, CAMERA[0] * CAMERA[1]).astype(np.float32)))
    assert choose_damping(T, 0.05, MASK).damping == min(CANDIDATES)


@pytest.mark.parametrize("shape", [(40, 25), (25, 40), (30, 30)])
def test_noise_alone_is_not_inverted(shape: tuple[int, int]) -> None:
    """T of rank 4 with noise of 1e-3: for every seed, amplification stays below the limit from the noise's norm."""
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        exact = rng.uniform(size=(shape[0], 4)) @ rng.uniform(size=(4, shape[1]))
        measured = exact * (1 + 1e-3 * rng.normal(size=shape))
        floor = noise_of_matrix(sparse.csr_array(measured), 1e-3)
        assert np.linalg.norm(measured - exact, 2) <= floor  # the bound that noise_of_matrix promises
        with_noise, without_noise = (damped_inverse(measured, np.zeros(()), noise) for noise in (1e-3, 0.0))
        assert np.linalg.norm(with_noise, 2) < 1 / floor
        assert np.linalg.matrix_rank(with_noise, tol=0.1 / np.linalg.norm(exact, 2)) == 4
        assert np.linalg.norm(without_noise, 2) > 1 / floor  # otherwise this test could not fail
        b = exact @ rng.uniform(size=shape[1])
        missed = exact @ (with_noise @ b) - b
        # first order in ‖N‖/σ₄: the rotation of the signal's four directions (Wedin 1973)
        assert np.linalg.norm(missed) <= 4 * floor / np.linalg.svd(exact)[1][3] * np.linalg.norm(b)


def test_known_noise_keeps_a_map_from_amplifying_it(rng: np.random.Generator) -> None:
    """The whole inverse of an ill-conditioned room, with and without a stated noise of 2 %."""
    near = (blurred_transport(rng, CAMERA, PROJECTOR, 0.9),) * 3
    reach = np.full((MASK.size, 3), 0.5)

    def gain(damping: float | None, noise: float) -> float:
        found = invert_near_light(stacked(near), MASK, PROJECTOR, reach, 0.5, InverseOptions(damping, 0.0, noise=noise))
        return float(np.linalg.norm(channels(found.T_pinv)[0].toarray(), 2))

    floor = noise_of_matrix(near[0], 0.02)
    assert gain(0.0, 0.02) <= 1 / floor
    assert gain(0.0, 0.0) > 2 / floor
    assert gain(None, 0.02) <= 1 / (2 * floor) * 1.01  # σ / (σ² + λ²) ≤ 1 / (2 λ); σ₁ is exact to 1 %


def test_no_candidate_is_below_the_noise(rng: np.random.Generator) -> None:
    T = blurred_transport(rng, CAMERA, PROJECTOR, 0.7)
    assert min(choose_damping(T, 0.5, MASK, floor=0.02).errors) == 0.02
    assert set(choose_damping(T, 0.5, MASK, floor=0.9).errors) == {0.9}


def test_a_single_weight_is_known_to_a_fifth() -> None:
    """In a cluster of one pixel each, row, column and 3 entries count: weights below 5 times the noise are dropped."""
    for noise, expected in ((0.19, 1 / 3), (0.21, 0.0)):
        assert damped_inverse(np.array([[3.0]]), np.zeros(()), noise)[0, 0] == pytest.approx(expected, rel=1e-12)
