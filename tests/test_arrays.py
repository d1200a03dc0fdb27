"""Archives of arrays: their headers are compared with their content before memory is allocated."""

import io
import struct
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from counterlight import memory
from counterlight.errors import InputError
from counterlight.tools.transport.arrays import opened_archive, opened_array
from counterlight.tools.transport.storage import read_matrix
from tests.hostile import little_memory

SHAPE = (48, 30)


@pytest.fixture
def matrix(rng: np.random.Generator) -> sparse.csr_array:
    return sparse.csr_array(sparse.random_array(SHAPE, density=0.2, rng=rng, dtype=np.float32))


@pytest.mark.parametrize("form", ["csr", "csc", "coo", "dia"])
@pytest.mark.parametrize("dtype", ["<f4", ">f8", "<f2", "<i4", ">i2", "<f16"])
def test_every_format_of_scipy_is_read(tmp_path: Path, matrix: sparse.csr_array, form: str, dtype: str) -> None:
    whole = np.rint(100 * matrix)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sparse.SparseEfficiencyWarning)  # scipy warns of many diagonals
        sparse.save_npz(tmp_path / "T.npz", whole.asformat(form))
    with np.load(tmp_path / "T.npz") as written:
        parts = dict(written)
    np.savez(tmp_path / "T.npz", **(parts | {"data": parts["data"].astype(dtype)}))  # scipy writes fewer types
    found = read_matrix(tmp_path / "T.npz", SHAPE)
    assert (found.format, found.dtype) == ("csr", np.float32)
    np.testing.assert_array_equal(found.toarray(), whole.toarray())


def test_blocks_and_long_indices_are_read(tmp_path: Path, matrix: sparse.csr_array) -> None:
    sparse.save_npz(tmp_path / "T.npz", matrix.tobsr((4, 5)))
    np.testing.assert_array_equal(read_matrix(tmp_path / "T.npz", SHAPE).toarray(), matrix.toarray())
    matrix.indices, matrix.indptr = matrix.indices.astype(np.int64), matrix.indptr.astype(np.int64)
    sparse.save_npz(tmp_path / "T.npz", matrix)
    np.testing.assert_array_equal(read_matrix(tmp_path / "T.npz", SHAPE).toarray(), matrix.toarray())


def arrays(**changes: object) -> dict[str, object]:
    """Arrays that save_npz writes for a 48x30 matrix of two entries, with changes; None leaves an array out."""
    rows = {"indptr": np.minimum(np.arange(49, dtype=np.int32), 2), "indices": np.array([3, 4], np.int32)}
    parts = {"format": b"csr", "shape": SHAPE, "data": np.array([0.5, 1], np.float32), **rows}
    return {name: value for name, value in (parts | changes).items() if value is not None}


def claiming(descr: str, shape: str, numbers: bytes = b"", *, length: int | None = None, version: int = 1) -> bytes:
    """Returns an .npy file with an arbitrary header."""
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n".encode("latin-1")
    size = struct.pack("<H" if version == 1 else "<I", len(header) if length is None else length)
    return b"\x93NUMPY" + bytes([version, 0]) + size + header + numbers


HOSTILE = {
    "no format": (arrays(format=None), "it has no array format"),
    "number as format": (arrays(format=7), "int64 of shape .., expected text, a single value"),
    "long format": (arrays(format=b"x" * 5000), "a matrix of the format ''"),
    "unknown format": (arrays(format=b"lil"), "a matrix of the format 'lil'"),
    "format of Python": (arrays(format=claiming("'|O'", "()", b"x" * 8)), "Python objects, which are never unpickled"),
    "shape of floats": (arrays(shape=(48.0, 30.0)), "float64 of shape .2,., expected whole numbers, 2"),
    "another shape": (arrays(shape=(30, 48)), "30x48 entries, expected 48 camera pixels .rows. x 30 projector pixels"),
    "a huge shape": (arrays(shape=(1 << 60, 30)), "1152921504606846976x30 entries, expected 48"),
    "complex": (arrays(data=np.ones(2, np.complex64)), "complex64 of shape .2,., expected real numbers"),
    "text": (arrays(data=np.array(["a", "b"])), "<U1 of shape .2,., expected real numbers"),
    "times": (arrays(data=np.zeros(2, "M8[s]")), "datetime64.s. of shape .2,., expected real numbers"),
    "truths": (arrays(data=np.ones(2, bool)), "bool of shape .2,., expected real numbers"),
    "a table": (arrays(data=np.ones((2, 1), np.float32)), "float32 of shape .2, 1., expected real numbers, n"),
    "float indices": (arrays(indices=np.ones(2)), "float64 of shape .2,., expected whole numbers, 2"),
    "fewer indices": (arrays(indices=np.array([1])), "int64 of shape .1,., expected whole numbers, 2"),
    "shorter rows": (arrays(indptr=np.arange(3)), "int64 of shape .3,., expected whole numbers, 49"),
    "rows that fall": (arrays(indptr=np.r_[0, 2, np.ones(47, int)]), "no sparse matrix"),
    "an index too large": (arrays(indices=np.array([3, 30])), "no sparse matrix"),
    "an index beyond int64": (arrays(indices=np.array([3, 2**64 - 1], np.uint64)), "no sparse matrix"),
    "more than places": (arrays(data=np.zeros(1441), indices=np.zeros(1441, int)), "1441 entries in a matrix of 48x30"),
    "NaN": (arrays(data=np.array([0.5, np.nan])), "1 of 2 entries are NaN or infinite; repair"),
    "beyond float32": (arrays(data=np.array([0.5, 1e300])), "1 of 2 entries are NaN or infinite; repair"),
    "no light": (arrays(data=np.array([0.5, -1e30])), r"an entry of 1e\+30, expected at most 1e\+12; give light in"),
    "coo of another shape": (
        arrays(format=b"coo", row=np.zeros(2, int), col=np.zeros(3, int)),
        "int64 of shape .3,., expected whole numbers, 2",
    ),
    "diagonals": (arrays(format=b"dia", data=np.zeros((2, 31)), offsets=np.arange(2)), "2 diagonals of 31 in a matrix"),
    "blocks": (arrays(format=b"bsr", data=np.zeros((2, 5, 7))), "blocks of 5x7 in a matrix of 48x30"),
    "blocks of nothing": (arrays(format=b"bsr", data=np.zeros((2, 0, 0))), "blocks of 0x0 in a matrix of 48x30"),
    # Each archive has a few hundred bytes, and would need gigabytes or crash Python's parser.
    "claims": (arrays(data=claiming("'<f4'", "(1000000000,)")), "'data' claims 4000000000 bytes, which are not what"),
    "claims 1e23": (arrays(data=claiming("'<f4'", "(99999999999999999999999,)")), "bytes, which are not what follows"),
    "a shape of floats": (arrays(data=claiming("'<f4'", "(1e23,)")), "a header that is not numpy's"),
    "a negative shape": (arrays(data=claiming("'<f4'", "(-2,)", b"x" * 8)), "an array of shape .-2,."),
    "a true shape": (arrays(data=claiming("'|u1'", "(True,)", b"x")), "an array of shape .True,."),
    "many dimensions": (arrays(data=claiming("'|u1'", f"({'1,' * 9})", b"x")), "an array of shape"),
    "no bytes an entry": (arrays(data=claiming("'|S0'", "(1000000000,)")), "an array of shape"),
    "parentheses": (arrays(data=claiming("(" * 9000, "(2,)")), "a header that is not numpy's"),
    "parentheses, few": (arrays(data=claiming("(" * 200, "(2,)")), "a header that is not numpy's"),
    "a long header": (arrays(data=claiming("'<f4'", "(2,)", length=(1 << 32) - 1, version=2)), "a header that is not"),
    "another version": (arrays(data=claiming("'<f4'", "(2,)", b"x" * 8, version=3)), "a header that is not numpy's"),
    "no array": (arrays(data=b"PK"), "a header that is not numpy's"),
    "a truncated array": (
        arrays(data=claiming("'<f4'", "(2,)", b"x" * 7)),
        "claims 8 bytes, which are not what follows",
    ),
    "more than its array": (arrays(data=claiming("'<f4'", "(2,)", b"x" * 9)), "claims 8 bytes, which are not what"),
    "many arrays": (arrays(**{f"a{i}": 0 for i in range(99)}), "104 arrays, at most 64 are read"),
}


def write(path: Path, parts: dict[str, object], kind: int = zipfile.ZIP_DEFLATED) -> None:
    """Write an archive of arrays; bytes that are an .npy file, or named `data`, are stored unchanged."""
    with zipfile.ZipFile(path, "w", kind) as archive:
        for name, value in parts.items():
            if isinstance(value, bytes) and (value.startswith(b"\x93") or name == "data"):
                archive.writestr(f"{name}.npy", value)
                continue
            stored = io.BytesIO()
            np.save(stored, np.asanyarray(value))  # type: ignore[arg-type]
            archive.writestr(f"{name}.npy", stored.getvalue())


@pytest.mark.parametrize("kind", HOSTILE)
def test_archives_that_are_no_matrix(tmp_path: Path, kind: str) -> None:
    parts, complaint = HOSTILE[kind]
    write(tmp_path / "T.npz", parts)
    with pytest.raises(InputError, match=rf"T\.npz: .*{complaint}") as caught, little_memory():
        read_matrix(tmp_path / "T.npz", SHAPE)
    assert len(str(caught.value)) < 700


def test_what_the_hostile_archives_were_made_from_is_a_matrix(tmp_path: Path) -> None:
    write(tmp_path / "T.npz", arrays())
    found = read_matrix(tmp_path / "T.npz", SHAPE)
    assert (found.nnz, found[0, 3], found[1, 4]) == (2, 0.5, 1)


def test_a_small_file_of_another_shape_asks_for_nothing(tmp_path: Path) -> None:
    """A `coo` file of 945 bytes, whose conversion to rows would take 4 GiB, is refused; so is a dense array."""
    shape = (500_000_000, 2)
    sparse.save_npz(tmp_path / "T.npz", sparse.coo_array(([1.0], ([3], [1])), shape=shape))
    with pytest.raises(InputError, match="500000000x2 entries, expected 48"), little_memory():
        read_matrix(tmp_path / "T.npz", SHAPE)
    np.savez_compressed(tmp_path / "T.npz", T=np.zeros((1000, 1000)))
    with pytest.raises(InputError, match=r"it holds arrays of numpy\.savez: .T."), little_memory():
        read_matrix(tmp_path / "T.npz", SHAPE)


def directory(change: Callable[[bytearray, int], None]) -> Callable[[Path], None]:
    """Returns a function that changes the zip directory's entry of `data`."""

    def damage(path: Path) -> None:
        content = bytearray(path.read_bytes())
        change(content, content.rindex(b"PK\x01\x02", 0, content.rindex(b"data.npy")))
        path.write_bytes(content)

    return damage


def put(offset: int, form: str, value: int) -> Callable[[Path], None]:
    return directory(lambda content, entry: struct.pack_into(form, content, entry + offset, value))


def end_record(offset: int, form: str, value: int) -> Callable[[Path], None]:
    def damage(path: Path) -> None:
        content = bytearray(path.read_bytes())
        struct.pack_into(form, content, content.rindex(b"PK\x05\x06") + offset, value)
        path.write_bytes(content)

    return damage


def holes(path: Path) -> None:
    """Grow the file to a terabyte whose directory claims to fill nearly all of it."""
    content = path.read_bytes()
    end = content.rindex(b"PK\x05\x06")
    with path.open("r+b") as file:
        file.truncate(1 << 40)
        file.seek((1 << 40) - 22)
        file.write(content[end : end + 12] + struct.pack("<II", 0xF0000000, 0) + b"\0\0")


def twice(path: Path) -> None:
    with warnings.catch_warnings(), zipfile.ZipFile(path, "a") as archive:
        warnings.simplefilter("ignore")  # zipfile warns of the second copy
        archive.writestr("data.npy", claiming("'<f4'", "(2,)", bytes(8)))


@pytest.mark.parametrize(
    ("damage", "complaint"),
    [
        (put(24, "<I", 1 << 31), "'data' claims 2147483648 bytes, more than the file can hold"),
        (put(20, "<I", 1 << 31), "'data' claims .* bytes, more than the file can hold"),
        (put(8, "<H", 1), "'data' is encrypted, or packed otherwise than by numpy"),
        (put(10, "<H", 12), "'data' is encrypted, or packed otherwise than by numpy"),
        (put(10, "<H", 99), "'data' is encrypted, or packed otherwise than by numpy"),
        (put(16, "<I", 0), "Bad CRC-32 for file 'data.npy'"),
        (put(42, "<I", 5), "Bad magic number for file header"),
        (end_record(12, "<I", 1 << 31), "Bad offset for central directory"),
        (holes, "its directory is damaged"),
        (twice, "two arrays 'data'"),
        (lambda path: path.write_bytes(path.read_bytes()[:-30]), "File is not a zip file"),
        (lambda path: path.write_bytes(b""), "File is not a zip file"),
    ],
)
def test_archives_whose_directory_lies(tmp_path: Path, damage: Callable[[Path], None], complaint: str) -> None:
    write(tmp_path / "T.npz", arrays())
    damage(tmp_path / "T.npz")
    with pytest.raises(InputError, match=rf"T\.npz: no sparse matrix \({complaint}"), little_memory():
        read_matrix(tmp_path / "T.npz", SHAPE)


def test_a_bomb_is_held_against_the_memory_that_there_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file of 256 KiB that unpacks to 256 MiB, as its header claims, is refused on a machine with 100 MiB."""
    with zipfile.ZipFile(tmp_path / "T.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("data.npy", claiming("'<f4'", f"({64 << 20},)", bytes(256 << 20)))
    assert (tmp_path / "T.npz").stat().st_size < 300_000
    monkeypatch.setattr(memory, "available_bytes", lambda: 100 << 20)
    with (
        pytest.raises(InputError, match=r"T\.npz: reading it needs about 0\.5 GiB of memory, 0\.1 GiB are available"),
        opened_archive(tmp_path / "T.npz", "no archive", "make it again"),
    ):
        pass


def test_fortran_order_is_kept(tmp_path: Path, rng: np.random.Generator) -> None:
    values = rng.uniform(size=(3, 4, 5))
    np.save(tmp_path / "a.npy", np.asfortranarray(values))
    with opened_array(tmp_path / "a.npy", "no array", "make it again") as stored:
        np.testing.assert_array_equal(stored.expect("f", 3, None, 5).read(), values)
    np.savez(tmp_path / "a.npz", a=np.asfortranarray(values), one=np.array(7))
    with opened_archive(tmp_path / "a.npz", "no archive", "make it again") as archive:
        np.testing.assert_array_equal(archive["a"].expect("fiu", 3, 4, 5).read(), values)
        assert int(archive["one"].expect("iu").read()) == 7
