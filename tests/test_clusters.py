"""Cluster decomposition: Appendix A against its pseudo-code, invariants of every cut, and the search for a size."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from counterlight.errors import InputError
from counterlight.passes.colour import LUMINANCE
from counterlight.tools.clusters.components import find_clusters, largest_cluster
from counterlight.tools.clusters.decomposition import Decomposition, Parameters, decompose
from counterlight.tools.clusters.search import decompose_to
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.transport.transport import Csr, Shape, channels, stacked
from tests.rooms import blurred_transport
from tests.scenes import small

CAMERA, PROJECTOR = (9, 11), (8, 13)
CUTS = [Parameters(*numbers) for numbers in ((1, 0.3), (1, 1, 0.5), (2, 0.6), (3, 1), (1.5, 0.9, 0), (1e9, 0.5))]
FLOAT32_SUM = 1e-6  # a kept weight is rounded once to float32 (6e-8 relative), all are positive, sums are in float64
Graph = tuple[tuple[Csr, ...], tuple[int, int], tuple[int, int]]


def random_graph(rng: np.random.Generator, levels: int = 0, density: float = 0.3) -> Graph:
    """Three channels with different patterns, and weights from 1e-7 to 1e3.

    With `levels` > 0, many weights are equal.
    """
    camera, projector = (int(rng.integers(1, 5)), int(rng.integers(1, 6))), tuple(rng.integers(1, 8, 2).tolist())
    shape = math.prod(camera), math.prod(projector)
    weights = 10 ** rng.uniform(-7, 3, (3, *shape))
    if levels:
        weights = rng.integers(1, levels + 1, (3, *shape)) / 4
    weights *= (rng.random(shape) < density) * (rng.random((3, *shape)) < 0.8)
    return tuple(sparse.csr_array(T.astype(np.float32)) for T in weights), camera, projector


def blurred_room(rng: np.random.Generator, sigma: float = 0.9) -> Graph:
    blur = blurred_transport(rng, CAMERA, PROJECTOR, sigma)
    tints = rng.uniform(0.5, 1, (3, blur.shape[0], 1)).astype(np.float32)
    return tuple(sparse.csr_array(blur.multiply(tint)) for tint in tints), CAMERA, PROJECTOR


def random_weights(rng: np.random.Generator, graph: Graph) -> Graph:
    """Scale every entry at random, because symmetric footprints have equal weights."""
    noisy = [sparse.csr_array(T.multiply(rng.uniform(0.5, 1, T.shape)).astype(np.float32)) for T in graph[0]]
    return tuple(noisy), *graph[1:]


def entries_reversed(T: Csr) -> Csr:
    """The same matrix with the entries of each row by descending column."""
    order = np.lexsort((-T.indices, np.repeat(np.arange(T.shape[0]), np.diff(T.indptr))))
    return sparse.csr_array((T.data[order], T.indices[order], T.indptr), shape=T.shape)


def simulated_room(name: str) -> Graph:
    scene = small(name)
    return (
        channels(simulate(scene).transport.near),
        (scene.camera.height, scene.camera.width),
        (scene.projector.height, scene.projector.width),
    )


def cut(matrices: tuple[Csr, ...], camera: Shape, projector: Shape, parameters: Parameters) -> Decomposition:
    return decompose(stacked(matrices), camera, projector, parameters)


def cut_to(
    matrices: tuple[Csr, ...], camera: Shape, projector: Shape, max_cluster: int
) -> tuple[Parameters, Decomposition]:
    return decompose_to(stacked(matrices), camera, projector, max_cluster)


def dense(matrices: tuple[Csr, ...]) -> NDArray[np.float64]:
    return np.stack([matrix.toarray().astype(np.float64) for matrix in matrices])


def pattern(matrices: tuple[Csr, ...]) -> NDArray[np.bool_]:
    """Pairs of a camera pixel and a projector pixel that any channel connects."""
    return np.asarray(dense(matrices).any(axis=0))


def check_invariants(graph: Graph, result: Decomposition) -> None:
    """Check the invariants of every cut, and the report."""
    before, after = dense(graph[0]), dense(channels(result.near))
    connected, kept = pattern(graph[0]), pattern(channels(result.near))
    assert not np.any(kept & ~connected), "a connection that never was"
    np.testing.assert_array_equal(kept.any(axis=1), connected.any(axis=1), "camera pixels in the dark")
    np.testing.assert_array_equal(kept.any(axis=0), connected.any(axis=0), "projector pixels cut off")
    np.testing.assert_allclose(after.sum(axis=2), before.sum(axis=2), rtol=FLOAT32_SUM)
    sizes = find_clusters(sparse.csr_array(kept)).projector_sizes
    report = result.report
    assert (report.connections_before, report.connections_after) == (connected.sum(), kept.sum())
    assert (report.clusters, report.largest_cluster) == (sizes.size, sizes.max(initial=0))


def appendix_a(graph: Graph, parameters: Parameters) -> tuple[NDArray[np.bool_], int]:
    """The thesis' pseudo-code line by line: kept connections, and the number of projector pixels that were cut off."""
    weights = dense(graph[0])
    luminance = LUMINANCE[0] * weights[0] + LUMINANCE[1] * weights[1] + LUMINANCE[2] * weights[2]
    left = luminance > 0
    for k in range(luminance.shape[0]):
        connections = [int(p) for p in np.flatnonzero(luminance[k])]
        while connections:
            w = max(connections, key=lambda p: (luminance[k, p], -p))
            block = [p for p in connections if math.dist(place(p, graph), place(w, graph)) <= parameters.radius]
            for p in block:
                if p != w and luminance[k, p] <= parameters.tau_1 * luminance[k, w]:
                    left[k, p] = False
            connections = [p for p in connections if p not in block]
    saved = 0
    for p in range(luminance.shape[1]):
        if luminance[:, p].any() and not left[:, p].any():
            saved += 1
            left[:, p] = (luminance[:, p] > 0) & (luminance[:, p] >= parameters.tau_2 * luminance[:, p].max())
    return left, saved


def place(p: int, graph: Graph) -> tuple[int, int]:
    return divmod(p, graph[2][1])


@settings(max_examples=200, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    levels=st.sampled_from([0, 3]),
    density=st.sampled_from([0.05, 0.3, 1.0]),
    radius=st.sampled_from([0, 0.5, 1, 1.5, 2, 3, 100]),
    tau_1=st.sampled_from([0, 0.25, 0.5, 0.9, 1]),
    tau_2=st.sampled_from([0, 0.5, 1]),
)
def test_random_graphs_are_cut_as_the_pseudo_code_says(
    seed: int, levels: int, density: float, radius: float, tau_1: float, tau_2: float
) -> None:
    graph = random_graph(np.random.default_rng(seed), levels, density)
    parameters = Parameters(radius, tau_1, tau_2)
    result = cut(*graph, parameters)
    expected, saved = appendix_a(graph, parameters)
    np.testing.assert_array_equal(pattern(channels(result.near)), expected)
    assert result.report.saved_pixels == saved
    check_invariants(graph, result)


@pytest.mark.parametrize("parameters", CUTS)
@pytest.mark.parametrize("sigma", [0.5, 0.9, 1.6])
def test_blurred_walls_keep_their_light(rng: np.random.Generator, sigma: float, parameters: Parameters) -> None:
    graph = blurred_room(rng, sigma)
    result = cut(*graph, parameters)
    check_invariants(graph, result)
    assert result.report.connections_after < result.report.connections_before
    np.testing.assert_array_equal(pattern(channels(result.near)), appendix_a(graph, parameters)[0])


@pytest.mark.parametrize("name", ["wall", "corner"])
def test_simulated_rooms_keep_their_light(name: str) -> None:
    graph = simulated_room(name)
    for parameters in CUTS:
        result = cut(*graph, parameters)
        check_invariants(graph, result)
        assert result.report.connections_after < result.report.connections_before


@pytest.mark.parametrize("parameters", [Parameters(0, 1), Parameters(0.99, 1), Parameters(1e300, 0), Parameters(3, 0)])
def test_no_neighbours_or_no_threshold_cut_nothing(rng: np.random.Generator, parameters: Parameters) -> None:
    graph = blurred_room(rng)
    result = cut(*graph, parameters)
    np.testing.assert_allclose(dense(channels(result.near)), dense(graph[0]), rtol=FLOAT32_SUM)
    assert result.report.saved_pixels == 0


def test_a_radius_beyond_the_picture_leaves_each_camera_pixel_its_strongest(rng: np.random.Generator) -> None:
    graph = random_weights(rng, blurred_room(rng))
    result = cut(*graph, Parameters(1e300, 1))
    report = result.report
    assert report.connections_after == math.prod(CAMERA) + report.saved_pixels
    assert report.saved_pixels > 0
    luminance = np.tensordot(LUMINANCE, dense(graph[0]), 1)
    kept = pattern(channels(result.near))
    assert kept[np.arange(kept.shape[0]), luminance.argmax(axis=1)].all()


def test_light_from_elsewhere_stays_when_overlap_goes() -> None:
    """A camera pixel sees a spot of 5 projector pixels and, dimmer, the reflection of a distant spot of 3."""
    T = np.zeros((1, 40))
    T[0, [4, 5, 6, 7, 8]] = 0.1, 0.5, 1.0, 0.4, 0.05
    T[0, [30, 31, 32]] = 0.02, 0.03, 0.01
    graph = (sparse.csr_array(T.astype(np.float32)),) * 3, (1, 1), (1, 40)
    wide = sparse.csr_array(np.vstack([T, np.eye(40)]).astype(np.float32))  # no projector pixel is cut off
    result = cut((wide,) * 3, (1, 41), (1, 40), Parameters(3, 0.45))
    np.testing.assert_array_equal(np.flatnonzero(pattern(channels(result.near))[0]), [5, 6, 30, 31])
    alone = cut(*graph, Parameters(3, 0.45))  # all other projector pixels are cut off and reinserted
    assert (alone.report.connections_after, alone.report.saved_pixels) == (8, 4)


def test_tau_2_reinserts_by_the_pixels_own_strongest() -> None:
    """Projector pixel 1 is never the strongest; its connections are 0.4, 0.3 and 0.1."""
    T = sparse.csr_array(np.array([[1, 0.4, 0], [0, 0.3, 1], [0, 0.1, 1]], np.float32))
    for tau_2, rows in ((1.0, [0]), (0.7, [0, 1]), (0.2, [0, 1, 2]), (0.0, [0, 1, 2])):
        result = cut((T, T, T), (1, 3), (1, 3), Parameters(1, 0.5, tau_2))
        np.testing.assert_array_equal(np.flatnonzero(pattern(channels(result.near))[:, 1]), rows)
        assert result.report.saved_pixels == 1


def test_a_channel_that_only_cut_connections_carried_stays_in_the_composition() -> None:
    red = sparse.csr_array(np.array([[0.2, 0, 0], [0, 0.5, 0]], np.float32))
    green = sparse.csr_array(np.array([[0, 0.6, 0.3], [0.7, 0.5, 0.1]], np.float32))
    result = cut((red, green, red), (2, 1), (1, 3), Parameters(5, 0.4))
    np.testing.assert_array_equal(pattern(channels(result.near)), [[False, True, True], [True, True, False]])
    # Red of camera pixel 0 came from projector pixel 0; the remaining pixels share it by luminance, 0.6 to 0.3.
    np.testing.assert_allclose(dense(channels(result.near))[0, 0], [0, 0.2 * 2 / 3, 0.2 / 3], rtol=FLOAT32_SUM)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.parametrize("make", [blurred_room, random_graph])
def test_the_unit_of_light_changes_nothing(rng: np.random.Generator, make, scale: float) -> None:  # type: ignore[no-untyped-def]
    graph: Graph = make(rng)
    scaled = tuple(sparse.csr_array(T * np.float32(scale)) for T in graph[0]), *graph[1:]
    for parameters in CUTS:
        reference, result = cut(*graph, parameters), cut(*scaled, parameters)
        assert result.report == reference.report
        # Both sides, and the scale, are float32.
        np.testing.assert_allclose(
            dense(channels(result.near)), scale * dense(channels(reference.near)), rtol=FLOAT32_SUM
        )
    if make is blurred_room:
        assert cut_to(*scaled, 30)[0] == cut_to(*graph, 30)[0]


def test_the_order_of_pixels_and_of_entries_changes_nothing(rng: np.random.Generator) -> None:
    near, camera, projector = random_weights(rng, blurred_room(rng))
    shuffled = rng.permutation(near[0].shape[0])
    mirrored = np.arange(near[0].shape[1]).reshape(projector)[::-1, ::-1].ravel()
    permuted = tuple(entries_reversed(sparse.csr_array(T[shuffled][:, mirrored])) for T in near)
    for parameters in CUTS:
        reference = dense(channels(cut(near, camera, projector, parameters).near))
        result = dense(channels(cut(permuted, camera, projector, parameters).near))
        expected = reference[:, shuffled][:, :, mirrored]
        np.testing.assert_allclose(result, expected, rtol=FLOAT32_SUM)


def test_equal_weights_are_cut_the_same_every_time() -> None:
    ones = sparse.csr_array(np.ones((6, 20), np.float32))
    first, second = (channels(cut((ones,) * 3, (2, 3), (4, 5), Parameters(1, 1)).near) for _ in range(2))
    np.testing.assert_array_equal(dense(first), dense(second))
    assert pattern(first)[:, 0].all(), "of equal weights, the first pixel is a block's strongest"


def test_an_empty_transport_stays_empty() -> None:
    nothing: Csr = sparse.csr_array(np.zeros((6, 20), np.float32))
    result = cut((nothing,) * 3, (2, 3), (4, 5), Parameters(2, 0.5))
    assert (result.report.clusters, result.report.largest_cluster, channels(result.near)[0].nnz) == (0, 0, 0)
    assert cut_to((nothing,) * 3, (2, 3), (4, 5), 1)[1].report == result.report


def test_the_matrices_are_independent_copies(rng: np.random.Generator) -> None:
    graph = blurred_room(rng)
    before = dense(graph[0])
    matrices = channels(cut(*graph, Parameters(2, 0.5)).near)
    rest = dense(matrices[1:])
    matrices[0].data[:] = 0
    matrices[0].eliminate_zeros()
    np.testing.assert_array_equal(dense(matrices[1:]), rest)
    np.testing.assert_array_equal(dense(graph[0]), before)


# The search for a size


@pytest.mark.parametrize("max_cluster", [1000, 60, 20, 6])
def test_every_cluster_is_within_the_size_asked_for(rng: np.random.Generator, max_cluster: int) -> None:
    graph = blurred_room(rng)
    parameters, result = cut_to(*graph, max_cluster)
    check_invariants(graph, result)
    assert result.report.largest_cluster <= max_cluster
    again = cut(*graph, parameters)
    np.testing.assert_array_equal(dense(channels(again.near)), dense(channels(result.near)))
    assert again.report == result.report


@pytest.mark.parametrize("name", ["wall", "corner"])
def test_smaller_clusters_keep_fewer_connections(name: str) -> None:
    graph = simulated_room(name)
    results = [cut_to(*graph, size)[1] for size in (10_000, 200, 50, 10)]
    for result, size in zip(results, (10_000, 200, 50, 10), strict=True):
        check_invariants(graph, result)
        assert result.report.largest_cluster <= size
    kept = [result.report.connections_after for result in results]
    assert all(more >= fewer for more, fewer in pairwise(kept))
    assert kept[0] == results[0].report.connections_before > kept[-1]


def test_clusters_that_are_small_enough_are_not_cut(rng: np.random.Generator) -> None:
    blocks = sparse.csr_array(sparse.block_diag([rng.uniform(0.1, 1, (3, 4)) for _ in range(5)]).astype(np.float32))
    parameters, result = cut_to((blocks,) * 3, (3, 5), (4, 5), 4)
    assert parameters == Parameters(0, 0)
    np.testing.assert_allclose(dense(channels(result.near))[0], blocks.toarray(), rtol=FLOAT32_SUM)


def test_the_impossible_says_what_is_possible() -> None:
    """One camera pixel sees six projector pixels that no other pixel sees: none may be cut off, so they stay."""
    T = sparse.csr_array(np.array([[6, 5, 4, 3, 2, 1]], np.float32))
    with pytest.raises(InputError, match=r"--max-cluster 5: .* has 6 projector pixels .*expected at least 6"):
        cut_to((T,) * 3, (1, 1), (2, 3), 5)
    assert cut_to((T,) * 3, (1, 1), (2, 3), 6)[1].report.largest_cluster == 6
    for size in (0, -3):
        with pytest.raises(InputError, match=f"--max-cluster {size}: expected at least 1"):
            cut_to((T,) * 3, (1, 1), (2, 3), size)


# Bad input


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ((-1, 0.5, 1), "--cut -1 0.5 1: found radius -1, expected 0 or more"),
        ((math.inf, 0.5, 1), "--cut inf 0.5 1: found radius inf, expected 0 or more"),
        ((math.nan, 0.5, 1), "--cut nan 0.5 1: found radius nan, expected 0 or more"),
        ((1, -0.1, 1), "--cut 1 -0.1 1: found TAU_1 -0.1, expected a fraction from 0 to 1"),
        ((1, 1.1, 1), "--cut 1 1.1 1: found TAU_1 1.1, expected a fraction from 0 to 1"),
        ((1, math.nan, 1), "--cut 1 nan 1: found TAU_1 nan, expected a fraction from 0 to 1"),
        ((1, 0.5, 2), "--cut 1 0.5 2: found TAU_2 2, expected a fraction from 0 to 1"),
    ],
)
def test_parameters_out_of_range_are_refused(numbers: tuple[float, float, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Parameters(*numbers)


@pytest.mark.parametrize("value", [-1e-3, np.nan, np.inf])
def test_a_transport_that_is_no_light_is_refused(value: float) -> None:
    good = sparse.csr_array(np.ones((6, 20), np.float32))
    bad = good.copy()
    bad.data[7] = value
    with pytest.raises(InputError, match="transport_green: 1 of 120 entries are negative, NaN or infinite"):
        cut((good, bad, good), (2, 3), (4, 5), Parameters(1, 0.5))
    with pytest.raises(InputError, match="transport: 6x20 entries, expected 6 camera pixels x 24 projector"):
        cut_to((good,) * 3, (2, 3), (4, 6), 5)


@pytest.mark.parametrize("seed", range(20))
def test_components_are_those_that_scipy_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows, columns = (int(n) for n in rng.integers(1, 60, 2))
    pattern = sparse.random_array((rows, columns), density=rng.random() / 10, format="csr", rng=rng)
    found = find_clusters(sparse.csr_array(pattern))
    both = sparse.block_array([[None, pattern], [pattern.T, None]])
    theirs = csgraph.connected_components(both, directed=False)[1]
    lit = np.concatenate([np.diff(pattern.indptr) > 0, np.diff(pattern.tocsc().indptr) > 0])
    labels = np.concatenate([found.camera, found.projector])
    assert np.array_equal(labels >= 0, lit)
    assert np.array_equal(labels[lit], np.unique(theirs[lit], return_inverse=True)[1])
    sizes = np.bincount(found.projector[found.projector >= 0], minlength=found.count)
    assert np.array_equal(found.projector_sizes, sizes)
    links = pattern.tocoo()
    keep = rng.random(links.nnz) < 0.7
    kept = sparse.csr_array((np.ones(keep.sum()), (links.row[keep], links.col[keep])), shape=pattern.shape)
    largest = largest_cluster(links.row.astype(np.int64), links.col.astype(np.int64), keep, rows, columns)
    assert largest == find_clusters(kept).projector_sizes.max(initial=0)
