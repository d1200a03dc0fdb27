"""The inverse: Penrose conditions, truth by construction, and certificates for the whole room."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from counterlight.errors import InputError
from counterlight.tools.clusters.components import find_clusters
from counterlight.tools.inverse.bidiagonal import largest_singular_value
from counterlight.tools.inverse.clustered import damped_inverse
from counterlight.tools.inverse.damping import choose_damping
from counterlight.tools.inverse.far_light import undo_far_light
from counterlight.tools.inverse.near_light import Inverse, InverseOptions, invert_near_light
from counterlight.tools.transport.transport import Csr, Transport, channels, far_light_of, luminance_matrix, stacked
from tests.rooms import blurred_transport

CAMERA, PROJECTOR = (15, 19), (12, 16)
KEEP_ALL = 0.0


def three_channels(rng: np.random.Generator, T: Csr) -> tuple[Csr, ...]:
    return tuple(sparse.csr_array(T.multiply(rng.uniform(0.5, 1, (T.shape[0], 1)))) for _ in range(3))


def invert(near: tuple[Csr, ...], options: InverseOptions, mask: NDArray[np.bool_] | None = None) -> Inverse:
    mask = np.ones(CAMERA, bool) if mask is None else mask
    return invert_near_light(stacked(near), mask, PROJECTOR, np.full((mask.size, 3), 0.5), 0.5, options)


@pytest.mark.parametrize("shape", [(8, 8), (13, 5), (5, 13)])
def test_the_plain_inverse_meets_the_penrose_conditions(rng: np.random.Generator, shape: tuple[int, int]) -> None:
    A = rng.uniform(size=(4, *shape))
    A[1, :, 0] = A[1, :, 1]  # one block is rank-deficient
    P = damped_inverse(A, np.zeros(4))
    for product in (A @ P, P @ A):
        np.testing.assert_allclose(product, np.swapaxes(product, 1, 2), atol=1e-9)  # cond ≤ 1e3 times float64 rounding
    np.testing.assert_allclose(A @ P @ A, A, atol=1e-9)
    np.testing.assert_allclose(P @ A @ P, P, atol=1e-7)  # the size of P enters squared


@pytest.mark.parametrize("shape", [(13, 5), (5, 13)])
def test_the_damped_inverse_solves_the_damped_normal_equations(
    rng: np.random.Generator, shape: tuple[int, int]
) -> None:
    A, damping = rng.uniform(size=(3, *shape)), np.array([0.3, 0.1, 0.02])
    P = damped_inverse(A, damping)
    At = np.swapaxes(A, 1, 2)
    left = (At @ A + damping[:, None, None] ** 2 * np.eye(shape[1])) @ P
    np.testing.assert_allclose(left, At, atol=1e-11)  # float64, condition of the damped system ≤ 1e5


def test_what_was_projected_is_recovered(rng: np.random.Generator) -> None:
    near = three_channels(rng, blurred_transport(rng, CAMERA, PROJECTOR, 0.5))
    p = rng.uniform(size=(near[0].shape[1], 3))
    matrices = channels(invert(near, InverseOptions(0.0, KEEP_ALL)).T_pinv)
    for channel in range(3):
        recovered = matrices[channel] @ (near[channel] @ p[:, channel])
        np.testing.assert_allclose(recovered, p[:, channel], atol=2e-4)  # float32 weights times their row's L1 norm


def test_batches_of_clusters_equal_one_dense_inverse(rng: np.random.Generator) -> None:
    blocks = [rng.uniform(0.1, 1, rng.integers(1, 5, 2)) for _ in range(60)]
    T = sparse.csr_array(sparse.block_diag(blocks))
    T = sparse.csr_array(T.toarray()[rng.permutation(T.shape[0])][:, rng.permutation(T.shape[1])].astype(np.float32))
    mask = np.ones((1, T.shape[0]), bool)
    reach = np.ones((T.shape[0], 3))
    for damping in (0.0, 0.05):
        result = invert_near_light(
            stacked((T, T, T)), mask, (1, T.shape[1]), reach, 1.0, InverseOptions(damping, KEEP_ALL)
        )
        assert result.clusters.count == 60
        expected = damped_inverse(T.toarray().astype(float), np.array(damping * largest_singular_value(T)))
        # float32 weights; the largest entry of a plain inverse of such blocks is below 1e3
        np.testing.assert_allclose(channels(result.T_pinv)[1].toarray(), expected, rtol=1e-5, atol=1e-5)


def test_decomposing_bounds_the_clusters_and_judges_by_the_whole_transport(rng: np.random.Generator) -> None:
    near = three_channels(rng, blurred_transport(rng, CAMERA, PROJECTOR, 0.6))
    cut = invert(near, InverseOptions(None, 0.5, max_cluster=20))
    assert cut.decomposition is not None
    assert cut.clusters.projector_sizes.max() <= 20
    assert cut.clusters.count > 5
    assert cut.T_pinv.indices.size < invert(near, InverseOptions(None, 0.5)).T_pinv.indices.size
    assert cut.damping_errors != choose_damping(luminance_matrix(stacked(near)), 0.5, np.ones(CAMERA, bool)).errors


def test_rows_outside_the_mask_take_no_part(rng: np.random.Generator) -> None:
    near = three_channels(rng, blurred_transport(rng, CAMERA, PROJECTOR, 0.5))
    mask = rng.uniform(size=CAMERA) > 0.3
    result = invert(near, InverseOptions(0.05, KEEP_ALL), mask)
    for matrix in channels(result.T_pinv):
        assert matrix[:, np.flatnonzero(~mask.ravel())].nnz == 0
    with pytest.raises(InputError, match="no camera pixel inside the mask"):
        invert(near, InverseOptions(0.05), np.zeros(CAMERA, bool))


def test_clusters_are_the_blocks_of_a_shuffled_block_matrix(rng: np.random.Generator) -> None:
    T = sparse.csr_array(sparse.block_diag([np.ones((2, 3)), np.ones((1, 1)), np.zeros((2, 2)), np.ones((4, 2))]))
    T.eliminate_zeros()
    clusters = find_clusters(T)
    assert clusters.count == 3
    assert sorted(zip(clusters.camera_sizes, clusters.projector_sizes, strict=True)) == [(1, 1), (2, 3), (4, 2)]
    assert np.count_nonzero(clusters.camera < 0) == 2
    rows, columns = T.nonzero()
    np.testing.assert_array_equal(clusters.camera[rows], clusters.projector[columns])


def test_far_light_is_undone(rng: np.random.Generator) -> None:
    """The drive p = S⁺ (b − U M' D' b) solves (S + U M D) p = b if S is invertible and D', M' are complete."""
    n, cells = 40, 5
    S = sparse.csr_array(np.eye(n) + 0.1 * rng.uniform(size=(n, n)))
    U = sparse.csr_array(rng.uniform(size=(n, cells)))
    D = sparse.csr_array(rng.uniform(size=(cells, n)) / n)
    M = 0.1 * rng.uniform(size=(cells, cells))
    far = far_light_of((D,) * 3, np.stack([M] * 3), (U,) * 3)
    S_inverse = sparse.csr_array(np.linalg.inv(S.toarray()))
    undo = undo_far_light(far, stacked((S_inverse,) * 3))
    p = rng.uniform(size=(n, 3))
    b = Transport.from_matrices((S,) * 3, far).apply(p)
    near_light = b[:, 0] - undo.apply(b)[:, 0]
    np.testing.assert_allclose(S_inverse @ near_light, p[:, 0], atol=1e-3)  # tails of gathers below 1e-4 are dropped


def test_transport_is_linear_and_its_transpose_is_one(rng: np.random.Generator) -> None:
    S = blurred_transport(rng, CAMERA, PROJECTOR, 0.7)
    far = far_light_of(
        tuple(sparse.random_array((7, S.shape[1]), density=0.2, rng=rng, format="csr") for _ in range(3)),
        rng.uniform(size=(3, 7, 7)),
        tuple(sparse.random_array((S.shape[0], 7), density=0.2, rng=rng, format="csr") for _ in range(3)),
    )
    T = Transport.from_matrices((S,) * 3, far)
    u, w = rng.normal(size=(S.shape[1], 3)), rng.normal(size=(S.shape[1], 3))
    v = rng.normal(size=(S.shape[0], 3))
    np.testing.assert_allclose(T.apply(2 * u - w), 2 * T.apply(u) - T.apply(w), atol=1e-10)  # float64 sums
    left, right = (T.apply(u) * v).sum(axis=0), (u * T.apply_transpose(v)).sum(axis=0)
    np.testing.assert_allclose(left, right, rtol=1e-9)  # ⟨Tu, v⟩ = ⟨u, Tᵀv⟩, float64 sums of a few thousand terms


def test_stacked_channels_share_the_union_of_their_patterns(rng: np.random.Generator) -> None:
    matrices = [sparse.random_array((9, 14), density=0.2, rng=rng, format="csr", dtype=np.float32) for _ in range(3)]
    rows = stacked(matrices)
    for found, matrix in zip(channels(rows), matrices, strict=True):
        np.testing.assert_array_equal(found.toarray(), matrix.toarray())
    assert np.all(rows.weights.any(axis=1))


@pytest.mark.parametrize("options", [{"damping": -0.1}, {"damping": 1.5}, {"max_error": -1}, {"max_error": 300}])
def test_options_out_of_range_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(InputError, match="expected"):
        InverseOptions(**options)
