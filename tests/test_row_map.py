"""The row map contract: pack, unpack, files, and every kind of damaged file."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from counterlight import memory
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.files.tables import Table
from counterlight.maps import row_map, shelves
from counterlight.maps.row_map import MAX_FLOAT_INDEX, RowMap, SparseRows, next_to_each_other, pack, unpack


def promised(sizes: dict[str, object]) -> Table:
    """Return the sizes of a row map as a manifest states them."""
    return Table(sizes, "manifest.toml", "rebuild it")


def random_rows(rng: np.random.Generator, lengths: np.ndarray, source_pixels: int) -> SparseRows:
    indptr = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    indices = rng.integers(0, source_pixels, indptr[-1])
    weights = rng.normal(size=(indptr[-1], 3)).astype(np.float32)
    return SparseRows(indptr, indices, weights, source_pixels)


def assert_same(a: SparseRows, b: SparseRows) -> None:
    np.testing.assert_array_equal(a.indptr, b.indptr)
    np.testing.assert_array_equal(a.indices, b.indices)
    np.testing.assert_array_equal(a.weights, b.weights)


@settings(max_examples=60, deadline=None)
@given(lengths=st.lists(st.integers(0, 40), min_size=6, max_size=6 * 30), seed=st.integers(0, 2**32 - 1))
def test_unpack_is_the_inverse_of_pack(lengths: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    height = len(lengths) // 6
    rows = random_rows(rng, np.array(lengths[: height * 6]), 35)
    assert_same(unpack(pack(rows, (height, 6), (5, 7), max_texture_width=64)), rows)


def test_blocks_leave_no_trace(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Packing writes entries block by block. A row may exceed a block, and many rows may be empty."""
    lengths = rng.integers(0, 30, 600) * rng.integers(0, 2, 600)
    rows = random_rows(rng, lengths, 35)
    whole = pack(rows, (20, 30), (5, 7))
    for most in (1, 17, 1000):
        monkeypatch.setattr(row_map, "BLOCK", most)
        packed = pack(rows, (20, 30), (5, 7))
        assert packed.entries.tobytes() == whole.entries.tobytes()
        assert_same(unpack(packed), rows)


def test_rows_next_to_each_other_are_both_matrices_columns(rng: np.random.Generator) -> None:
    left, right = (random_rows(rng, rng.integers(0, 5, 40), columns) for columns in (30, 70))
    dense = [np.zeros((40, rows.columns, 3)) for rows in (left, right)]
    for whole, rows in zip(dense, (left, right), strict=True):
        np.add.at(whole, (rows.rows, rows.indices), rows.weights)
    found = np.zeros((40, 100, 3))
    both = next_to_each_other(left, right)
    np.add.at(found, (both.rows, both.indices), both.weights)
    np.testing.assert_array_equal(found, np.concatenate(dense, axis=1))


def test_a_map_higher_than_any_texture(tmp_path: Path, rng: np.random.Generator) -> None:
    """A narrow width replaces the limit of 16384 texels. Files and the CPU have no height limit; OpenGL draws tiles."""
    rows = random_rows(rng, np.full(20000, 3), 35)
    packed = pack(rows, (100, 200), (5, 7), max_texture_width=3)
    assert packed.entries.shape[:2] == (20000, 3)
    loaded = row_map.read(tmp_path, promised(row_map.write(packed, tmp_path)))
    assert_same(unpack(loaded), rows)


def test_more_entries_than_a_map_or_memory_holds_are_refused(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = random_rows(rng, np.full(600, 3), 35)
    monkeypatch.setattr(memory, "available_bytes", lambda: 1800 * 16 - 1)
    with pytest.raises(InputError, match=r"packing 1800 entries needs about .* GiB of memory.*--max-cluster"):
        pack(rows, (20, 30), (5, 7))
    monkeypatch.undo()
    monkeypatch.setattr(shelves, "MOST_TEXELS", 1799)
    with pytest.raises(InputError, match=r"row map: 1800 entries, a map holds at most 1799; .*--max-cluster"):
        pack(rows, (20, 30), (5, 7))


def test_no_row_breaks_and_none_overlaps(rng: np.random.Generator) -> None:
    packed = pack(random_rows(rng, rng.integers(0, 90, 600), 35), (20, 30), (5, 7), max_texture_width=128)
    used = np.zeros(packed.entries.shape[:2], int)
    for x, y, length in packed.lookup.reshape(-1, 3):
        assert x + length <= packed.entries.shape[1]
        used[y, x : x + length] += 1
    assert used.max() == 1
    assert used.sum() == packed.count


@pytest.mark.parametrize("name", ["uniform", "window", "mixed"])
def test_the_texture_is_full(rng: np.random.Generator, name: str) -> None:
    lengths = {
        "uniform": np.full(96 * 128, 25),
        "window": np.clip(rng.normal(110, 30, 96 * 128), 0, None).astype(int),
        "mixed": rng.integers(0, 400, 96 * 128),
    }[name]
    packed = pack(random_rows(rng, lengths, 35), (96, 128), (5, 7))
    assert packed.fill >= 0.99  # stated in docs/mathematics.md 5


def test_entries_of_zero_are_left_out() -> None:
    weights = np.array([[1, 0, 0], [0, 0, 0], [0, 0, 2]], np.float32)
    rows = SparseRows(np.array([0, 3]), np.array([0, 1, 2]), weights, 3)
    result = unpack(pack(rows, (1, 1), (1, 3)))
    np.testing.assert_array_equal(result.indices, [0, 2])


def test_rows_of_nothing_at_all() -> None:
    empty = SparseRows.empty(6, 16)
    packed = pack(empty, (2, 3), (4, 4))
    assert packed.count == 0
    assert_same(unpack(packed), empty)
    sums = empty.sums()
    assert sums.dtype == np.float64
    np.testing.assert_array_equal(sums, np.zeros((6, 3)))


def test_index_is_exact_in_the_alpha_channel_up_to_its_limit() -> None:
    indices = np.array([0, 1, MAX_FLOAT_INDEX // 2 + 1, MAX_FLOAT_INDEX - 2, MAX_FLOAT_INDEX - 1])
    rows = SparseRows(np.array([0, indices.size]), indices, np.ones((indices.size, 3), np.float32), 4097 * 4096)
    packed = pack(rows, (1, 1), (4096, 4096))
    assert packed.index is None
    np.testing.assert_array_equal(unpack(packed).indices, indices)


def test_more_source_pixels_than_a_float_counts_get_an_index_texture(tmp_path: Path) -> None:
    indices = np.array([0, MAX_FLOAT_INDEX, MAX_FLOAT_INDEX + 1, MAX_FLOAT_INDEX + 4095])
    rows = SparseRows(np.array([0, indices.size]), indices, np.ones((indices.size, 3), np.float32), 4097 * 4096)
    packed = pack(rows, (1, 1), (4097, 4096))
    assert packed.index is not None
    sizes = row_map.write(packed, tmp_path)
    np.testing.assert_array_equal(unpack(row_map.read(tmp_path, promised(sizes))).indices, indices)


def test_files_are_bit_exact(tmp_path: Path, rng: np.random.Generator) -> None:
    rows = random_rows(rng, rng.integers(0, 30, 13 * 7), 11 * 5)
    rows.weights[:4] = [[np.float32(1e-45)] * 3, [np.float32(3.4e38)] * 3, [-0.0, 1, 1], [np.pi, np.e, 1 / 3]]
    packed = pack(rows, (13, 7), (11, 5))
    loaded = row_map.read(tmp_path, promised(row_map.write(packed, tmp_path)))
    assert loaded.entries.tobytes() == packed.entries.tobytes()
    assert loaded.lookup.tobytes() == packed.lookup.tobytes()
    assert loaded.source_shape == packed.source_shape


def test_a_row_that_no_texture_holds_is_named() -> None:
    rows = SparseRows(np.array([0, 0, 0, 0, 65]), np.zeros(65, np.int64), np.ones((65, 3), np.float32), 1)
    with pytest.raises(InputError, match=r"pixel \(1, 1\) has 65 entries.*holds 64.*--max-error"):
        pack(rows, (2, 2), (1, 1), max_texture_width=64)


@pytest.mark.parametrize(
    ("damage", "complaint"),
    [
        (lambda m: m.lookup.__setitem__((0, 0), (m.entries.shape[1], 0, 1)), "points outside"),
        (lambda m: m.lookup.__setitem__((0, 0), (0, m.entries.shape[0], 1)), "points outside"),
        (lambda m: m.entries.__setitem__((0, 0, 0), np.nan), "NaN or infinity"),
        (lambda m: m.entries.__setitem__((0, 0, 1), np.inf), "NaN or infinity"),
        (lambda m: m.entries.__setitem__((0, 0, 3), 35), "outside the 35 source pixels"),
        (lambda m: m.entries.__setitem__((0, 0, 3), -1), "outside the 35 source pixels"),
        (lambda m: m.entries.__setitem__((0, 0, 3), 0.5), "outside the 35 source pixels"),
    ],
)
def test_contents_that_would_mislead_a_shader_are_refused(
    tmp_path: Path, rng: np.random.Generator, damage: object, complaint: str
) -> None:
    packed = pack(random_rows(rng, np.full(6, 3), 35), (2, 3), (5, 7))
    damage(packed)  # type: ignore[operator]
    sizes = row_map.write(packed, tmp_path)
    with pytest.raises(InputError, match=complaint):
        row_map.read(tmp_path, promised(sizes))


def test_files_of_other_sizes_or_types_are_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    packed = pack(random_rows(rng, np.full(6, 3), 35), (2, 3), (5, 7))
    sizes = row_map.write(packed, tmp_path)
    with pytest.raises(InputError, match="promises 4x3"):
        row_map.read(tmp_path, promised(sizes | {"output": [4, 3]}))
    with pytest.raises(InputError, match="at most 1073741824 pixels"):
        row_map.read(tmp_path, promised(sizes | {"texture": [1 << 20, 1 << 20]}))
    exr.write_channels(tmp_path / "lookup.exr", {c: packed.lookup[..., 0].astype(np.float32) for c in "XY"})
    with pytest.raises(InputError, match="promises"):
        row_map.read(tmp_path, promised(sizes))
    floats = {c: packed.lookup[..., 0].astype(np.float32) for c in ("X", "Y", "LENGTH")}
    exr.write_channels(tmp_path / "lookup.exr", floats)
    with pytest.raises(InputError, match="not uint32"):
        row_map.read(tmp_path, promised(sizes))


def test_sizes_add_up(rng: np.random.Generator) -> None:
    packed: RowMap = pack(random_rows(rng, np.full(6, 3), 35), (2, 3), (5, 7))
    assert packed.count == 18
    assert packed.nbytes == 6 * 12 + packed.entries.shape[0] * packed.entries.shape[1] * 16
