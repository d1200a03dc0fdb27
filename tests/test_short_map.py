"""Weights of 16 bits: what rounding them changes at most, and when a room's map may have them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from counterlight.maps.row_map import RowMap, SparseRows, pack, unpack
from counterlight.maps.short_map import half_scale, in_half, to_half
from tests.packing import pack_matrices


def test_the_bound_of_16_bit_weights_is_reached_and_never_passed(rng: np.random.Generator) -> None:
    """The worst desired light has the signs of the rounding errors: nothing else comes so far."""
    dense = [40 * rng.normal(size=(42, 45)) * (rng.uniform(size=(42, 45)) < 0.2) for _ in range(3)]
    packed = pack_matrices([sparse.csr_array(T, dtype=np.float32) for T in dense], (6, 7), (5, 9))
    ambient, white = rng.uniform(0, 2, (45, 3)).astype(np.float32), 1.3
    rounded, bound = in_half(packed, np.maximum(white, ambient))
    reach = np.maximum(white, ambient.astype(float))
    before, after = ([T.toarray() for T in matrices(each)] for each in (packed, rounded))
    changes = []
    for i, error in enumerate(np.subtract(after, before)):
        changes.append(np.max(np.sum(np.abs(error) * reach[:, i], axis=1)))
        random_light = rng.uniform(-1, 1, (45, 20)) * reach[:, [i]]
        assert np.max(np.abs(error @ random_light)) <= bound * (1 + 1e-5)
    assert bound == pytest.approx(max(changes), rel=1e-5)  # products of float32
    assert np.max(np.abs(np.subtract(after, before))) > 0
    np.testing.assert_allclose(after, before, rtol=2**-11, atol=2**-24)  # half's rounding, and its smallest step


@pytest.mark.parametrize("largest", [1e-3, 63.9, 64.13, 1e6])
def test_16_bit_weights_fill_their_range_and_never_leave_it(largest: float) -> None:
    """64.13 is just too much for a scale of 1024; in 16 bits log2(65504 / 64.13) would be rounded up to 10."""
    dense = largest * np.array([[1.0, -0.3, 0.0], [0.5, 0.01, -1.0]])
    packed = pack_matrices([sparse.csr_array(dense, dtype=np.float32)] * 3, (1, 2), (1, 3))
    rounded, bound = in_half(packed, np.ones((3, 3)))
    np.testing.assert_allclose(matrices(rounded)[0].toarray(), dense, rtol=2**-11)
    assert 0 < bound <= 1.5 * largest * 2**-11


@pytest.mark.parametrize("size", [1e-20, 1.0, 1e20])
def test_halves_give_the_map_that_the_bound_was_computed_for(rng: np.random.Generator, size: float) -> None:
    """Weights down to 1e-12 of the largest, which halves cannot hold, are 0 and not denormal."""
    weights = size * 10.0 ** rng.uniform(-12, 0, (200, 3))
    rows = SparseRows(np.arange(0, 201, 10), rng.integers(0, 45, 200), weights.astype(np.float32), 45)
    packed = pack(rows, (4, 5), (5, 9))
    halves = to_half(rows.weights, half_scale(packed))
    assert np.isfinite(halves).all()
    assert set(np.abs(halves[np.abs(halves) < np.finfo(np.float16).smallest_normal])) == {0}
    rounded, bound = in_half(packed, np.ones((45, 3)))
    expected = pack(replace(rows, weights=halves.astype(np.float32) / half_scale(packed)), (4, 5), (5, 9))
    np.testing.assert_array_equal(written_out(rounded), written_out(expected))
    change = np.abs(written_out(rounded) - written_out(packed)).sum(axis=1).max()
    assert bound == pytest.approx(change, rel=1e-5)  # sums of float32


def written_out(packed: RowMap) -> np.ndarray:
    """(rows, columns, channels); entries of one place add up."""
    rows = unpack(packed)
    dense = np.zeros((rows.lengths.size, packed.source_shape[0] * packed.source_shape[1], 3))
    np.add.at(dense, (np.repeat(np.arange(rows.lengths.size), rows.lengths), rows.indices), rows.weights)
    return dense


def matrices(packed: RowMap) -> list[sparse.csr_array]:
    rows = unpack(packed)
    shape = rows.lengths.size, packed.source_shape[0] * packed.source_shape[1]
    return [
        sparse.csr_array((rows.weights[:, i].astype(float), rows.indices, rows.indptr), shape=shape) for i in range(3)
    ]
