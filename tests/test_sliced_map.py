"""The order of a map in GPU buffers: no entry lost, rows of equal length together, slices within their size."""

import numpy as np
import pytest

from counterlight.maps.row_map import RowMap, SparseRows, pack, unpack
from counterlight.maps.sliced_map import GROUP, NO_PIXEL, Part, lanes_of, parts, row_order
from tests.rooms import random_map

OUTPUT, SOURCE = (19, 23), (31, 40)


def unsliced(found: list[Part], lanes: int) -> dict[tuple[int, int], list[tuple[float, ...]]]:
    """Return output pixel -> its (x, y, w_R, w_G, w_B), read entry by entry as the shader reads."""
    result: dict[tuple[int, int], list[tuple[float, ...]]] = {}
    for part in found:
        for pixel, _, length, first in part.rows.tolist():
            if pixel == NO_PIXEL:
                assert length == 0
                continue
            at = pixel & 0xFFFF, pixel >> 16
            assert at not in result
            result[at] = []
            for k in range(length):
                entry = part.entries[first + k // lanes * GROUP + k % lanes]
                result[at].append(long_entry(entry))
    return result


def long_entry(entry: np.ndarray) -> tuple[float, ...]:
    return int(entry[3]) & 0xFFFF, int(entry[3]) >> 16, *entry[:3].view(np.float32).tolist()


def expected(packed: RowMap) -> dict[tuple[int, int], list[tuple[float, ...]]]:
    rows, width = unpack(packed), packed.output_shape[1]
    result = {}
    for i, (start, stop) in enumerate(zip(rows.indptr, rows.indptr[1:], strict=False)):
        y, x = np.divmod(rows.indices[start:stop], packed.source_shape[1])
        columns = [x.tolist(), y.tolist(), *(rows.weights[start:stop, j].tolist() for j in range(3))]
        result[i % width, i // width] = list(zip(*columns, strict=True))
    return result


@pytest.mark.parametrize("lanes", [1, 4, 64])
@pytest.mark.parametrize("most", [1, 4000, 1 << 30])
def test_every_entry_is_there_once(rng: np.random.Generator, lanes: int, most: int) -> None:
    packed = random_map(rng, OUTPUT, SOURCE, 90)
    found = list(parts(packed, lanes, most))
    assert unsliced(found, lanes) == expected(packed)
    assert all(len(part.rows) * lanes % GROUP == 0 for part in found)
    assert max(len(part.entries) for part in found) <= max(most, -(-90 // lanes) * GROUP)


def test_an_empty_map_has_rows_and_no_entries() -> None:
    empty = SparseRows.empty(6, 20)
    packed = pack(empty, (2, 3), SOURCE)
    (part,) = parts(packed, lanes_of(packed), 1 << 20)
    assert part.entries.shape == (0, 4)
    assert (part.rows[:, 0] != NO_PIXEL).sum() == 6


def test_a_workgroups_rows_are_about_equally_long(rng: np.random.Generator) -> None:
    """The longest row of a bin is at most 2^(1/8) of the shortest. Padding is below a tenth, except where bins meet."""
    lengths = rng.integers(0, 400, 128 * 128)
    ordered = lengths[row_order(lengths, (128, 128))]
    groups = ordered.reshape(-1, GROUP)
    assert groups.max(axis=1).sum() * GROUP < 1.1 * lengths.sum()
    assert np.mean(groups.max(axis=1) <= np.maximum(groups.min(axis=1), 1) * 2**0.125 + 1) > 0.8
    assert sorted(row_order(lengths, (128, 128))) == list(range(128 * 128))


def test_rows_of_one_length_go_tile_by_tile() -> None:
    y, x = np.divmod(row_order(np.full(24 * 40, 9), (24, 40)), 40)
    for group in np.stack([y, x], axis=1).reshape(-1, GROUP, 2):
        assert (np.ptp(group, axis=0) == 7).all()


def test_few_long_rows_are_shared(rng: np.random.Generator) -> None:
    assert lanes_of(random_map(rng, (300, 400), (50, 50), 30)) == 1
    assert lanes_of(random_map(rng, (1, 6), (50, 50), 2000)) == GROUP
    assert lanes_of(random_map(rng, (1, 6), (50, 50), 2)) == 1
