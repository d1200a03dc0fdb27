"""Windows: rows of a damped inverse solved locally, certified by their residual, and the choice of method."""

import numpy as np
import pytest
from scipy import sparse

from counterlight.errors import InputError
from counterlight.tools.clusters.components import find_clusters
from counterlight.tools.inverse import method as method_module
from counterlight.tools.inverse.banded import columns_of_inverse, last_columns_of_inverse
from counterlight.tools.inverse.clustered import damped_inverse
from counterlight.tools.inverse.method import choose_method
from counterlight.tools.inverse.near_light import Inverse, InverseOptions, invert_near_light
from counterlight.tools.inverse.rows import Truncation
from counterlight.tools.inverse.windows import (
    HALOS,
    WindowedChannel,
    Windows,
    plan_windows,
    windowed_jobs,
)
from counterlight.tools.transport.transport import Csr, channels, stacked
from tests.rooms import blurred_transport

CAMERA, PROJECTOR = (22, 40), (18, 34)
KEEP_ALL = 0.0
EVERYWHERE = np.ones(PROJECTOR, bool)


@pytest.fixture
def blur(rng: np.random.Generator) -> Csr:
    return blurred_transport(rng, CAMERA, PROJECTOR, 0.6)


def invert(near: tuple[Csr, ...], damping: float = 0.1, max_error: float = KEEP_ALL) -> Inverse:
    reach = np.full((CAMERA[0] * CAMERA[1], 3), 0.5)
    options = InverseOptions(damping, max_error, inverse="whole")
    return invert_near_light(stacked(near), np.ones(CAMERA, bool), PROJECTOR, reach, 0.5, options)


def test_last_columns_of_inverse(rng: np.random.Generator) -> None:
    A = rng.normal(size=(30, 40))
    N = A @ A.T + np.eye(30)
    for count in (1, 11, 30):
        found = last_columns_of_inverse(np.asfortranarray(N.copy()), count)
        # float64, with a condition of 200
        np.testing.assert_allclose(found, np.linalg.inv(N)[:, 30 - count :], atol=1e-12)


@pytest.mark.parametrize("reach", [1, 7, 29])  # a narrow band, a wide band, and a reach too wide for a band solver
@pytest.mark.parametrize("rasters", [1, 2])  # neighbours side by side, or every second one in the other raster
def test_columns_of_inverse_of_a_band(rng: np.random.Generator, reach: int, rasters: int) -> None:
    A = np.triu(np.tril(rng.normal(size=(30, 30)), reach), -reach)
    order = np.argsort(np.arange(30) % rasters, kind="stable")
    N = (A @ A.T + np.eye(30))[np.ix_(order, order)]
    wanted = np.array([2, 3, 11, 28])
    found = columns_of_inverse(sparse.csr_array(N), wanted)
    np.testing.assert_allclose(found, np.linalg.inv(N)[:, wanted], atol=1e-12)  # float64, with a condition of 200
    with pytest.raises(np.linalg.LinAlgError):
        columns_of_inverse(sparse.csr_array(N - 10 * np.trace(N) * np.eye(30)), wanted)


def test_the_residual_says_exactly_what_a_window_misses(rng: np.random.Generator, blur: Csr) -> None:
    """Row x on a window has r = N x − 1_i, and p̃_i − p_i = rᵀ p, at most ‖r‖₁ max|p|; p is the exact drive."""
    channel = WindowedChannel(blur, damping := 0.05)
    windows = Windows(EVERYWHERE, 4, 8)
    corner = (5, 12)
    block = windows.pixels(corner, 0)
    T = blur.toarray().astype(float)
    exact_inverse = damped_inverse(T, np.array(damping))
    previous = np.inf
    for halo in (1, 2, 4):
        found = channel.solve(block, windows.pixels(corner, halo))
        rows = np.zeros((block.size, T.shape[0]))
        rows[:, found.camera] = found.columns.T
        pictures = rng.uniform(size=(T.shape[0], 20))
        drives = exact_inverse @ pictures
        change = np.abs(rows @ pictures - drives[block])
        bound = found.residual[:, None] * np.abs(drives).max(axis=0)
        assert np.all(change <= bound + 1e-12)
        assert found.residual.max() < previous
        previous = found.residual.max()


def test_a_window_that_holds_everything_leaves_nothing(blur: Csr) -> None:
    channel = WindowedChannel(blur, 0.05)
    everything = np.arange(blur.shape[1])
    found = channel.solve(everything[100:130], everything)
    assert found.residual.max() == 0
    expected = damped_inverse(blur.toarray().astype(float), np.array(0.05))[100:130]
    # float64, with a condition of 1e3
    np.testing.assert_allclose(found.columns.T, expected[:, found.camera], atol=1e-10)


def test_windows_agree_with_the_whole(rng: np.random.Generator, blur: Csr, monkeypatch: pytest.MonkeyPatch) -> None:
    near = tuple(sparse.csr_array(blur.multiply(rng.uniform(0.5, 1, (blur.shape[0], 1)))) for _ in range(3))
    whole = invert(near)
    monkeypatch.setattr(method_module, "LARGEST_DENSE", 100)
    windowed = invert(near)
    assert (whole.windowed_clusters, windowed.windowed_clusters) == (0, 1)
    assert windowed.residual.max() <= windowed.window_tolerance
    picture = 0.5 * rng.uniform(size=CAMERA[0] * CAMERA[1])
    for a, b in zip(channels(whole.T_pinv), channels(windowed.T_pinv), strict=True):
        exact = a @ picture
        change = np.abs(exact - b @ picture)
        assert np.all(change <= windowed.residual * np.abs(exact).max() + 1e-5)  # float32 weights, row sums below 40


def test_each_block_grows_its_own_halo(rng: np.random.Generator) -> None:
    """A room in focus on the left and out of focus on the right needs wide windows on the right only."""
    sharp, soft = (blurred_transport(rng, CAMERA, PROJECTOR, sigma) for sigma in (0.35, 1.0))
    columns = np.tile(np.arange(PROJECTOR[1]), PROJECTOR[0])
    right = sparse.diags_array((columns >= 17).astype(np.float32))
    left = sparse.diags_array((columns < 17).astype(np.float32))
    T = sparse.csr_array((soft @ right + sharp @ left).astype(np.float32))
    channel, tolerance = WindowedChannel(T, 0.1), 1e-3
    truncation = Truncation(np.full((T.shape[0], 3), 0.5), 0.0)
    windows = Windows(EVERYWHERE, HALOS[0], 8)
    pieces = [job() for job in windowed_jobs((channel,) * 3, windows, truncation, tolerance)]
    halos = np.array([piece.halo for piece in pieces])
    on_the_right = np.array([columns[piece.rows[0]] >= 17 for piece in pieces])
    assert np.median(halos[on_the_right]) > np.median(halos[~on_the_right])
    assert max(piece.residual.max() for piece in pieces) <= tolerance
    assert halos.max() < HALOS[-1]  # the tolerance is met, not abandoned
    assert plan_windows(channel, EVERYWHERE, tolerance).windows.halo in halos


def test_a_channel_that_needs_more_gets_more(rng: np.random.Generator, blur: Csr) -> None:
    soft = blurred_transport(rng, CAMERA, PROJECTOR, 1.2)
    channels = tuple(WindowedChannel(T, 0.02) for T in (soft, blur, blur))
    windows = Windows(EVERYWHERE, HALOS[0], 8)
    truncation = Truncation(np.full((blur.shape[0], 3), 0.5), 0.0)
    sharp, mixed = (next(windowed_jobs(parts, windows, truncation, 1e-3))() for parts in ((channels[1],) * 3, channels))
    assert mixed.halo > sharp.halo
    assert mixed.residual.max() <= 1e-3


@pytest.mark.parametrize(
    ("sizes", "damping", "expected"),
    [
        ([(3, 900), (2, 5)], None, "clustered: the largest of 2 clusters has 900 projector pixels, within the"),
        ([(3, 1200), (2, 5)], 0.1, "windowed: one cluster of 1 200 projector pixels is beyond the 1 000 inver"),
        ([(3, 1200), (4, 1100), (2, 5)], 0.1, "windowed: 2 of 3 clusters, of up to 1 200 projector pixels, ar"),
        ([(30_000, 700)], 0.1, "windowed: one cluster of 700 projector pixels is with its camera pixels beyon"),
        ([(3, 1200)], 0.0, "clustered: the largest of 1 clusters has 1 200 projector pixels, within the 4 000"),
    ],
)
def test_the_method_says_why(sizes: list[tuple[int, int]], damping: float | None, expected: str) -> None:
    assert str(choose_method(clusters_of(sizes), damping)).startswith(expected)


def clusters_of(sizes: list[tuple[int, int]]) -> object:
    """Clusters of these (camera, projector) sizes: the first camera pixel sees all, the others the first pixel."""
    blocks = []
    for m, n in sizes:
        rows = np.concatenate([np.zeros(n, int), np.arange(1, m)])
        columns = np.concatenate([np.arange(n), np.zeros(m - 1, int)])
        blocks.append(sparse.csr_array((np.ones(rows.size), (rows, columns)), shape=(m, n)))
    return find_clusters(sparse.csr_array(sparse.block_diag(blocks)))


@pytest.mark.parametrize("damping", [0.0, 1e-7])
def test_a_large_cluster_has_no_plain_inverse(blur: Csr, damping: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(method_module, "LARGEST_PLAIN", 100)
    with pytest.raises(InputError, match=r"cluster of 612 projector pixels.*--regularize auto"):
        invert((blur,) * 3, damping)


def test_a_residual_that_is_not_met_is_reported(rng: np.random.Generator) -> None:
    """With little damping and much blur, rows do not decay within the widest window."""
    T = blurred_transport(rng, CAMERA, PROJECTOR, 1.5)
    channel = WindowedChannel(T, 1e-4)
    found = next(
        windowed_jobs(
            (channel,) * 3, Windows(EVERYWHERE, HALOS[0], 4), Truncation(np.full((T.shape[0], 3), 0.5), 0), 1e-3
        )
    )()
    assert found.halo == HALOS[1]  # the second halo shows that the widest would also fail
    assert found.residual.max() > 1e-3
    widest = channel.solve(found.rows, np.arange(T.shape[1])[EVERYWHERE.ravel()][: -PROJECTOR[1] * 2])
    assert widest.residual.max() > 1e-3
