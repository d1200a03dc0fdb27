"""counterlight import-transport as a user runs it: matrices are stored unchanged; errors are one line."""

import contextlib
import io
import re
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import sparse

import counterlight as cl
from counterlight import calibration
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.response import Response
from counterlight.tools.import_transport import main
from counterlight.tools.transport.mask import lit_pixels
from counterlight.tools.transport.storage import read_matrix, read_transport
from counterlight.tools.transport.transport import CHANNELS, channel, channels
from tests.pixel_orders import smooth
from tests.programs import refusal_here

CAMERA, PROJECTOR = (9, 13), (7, 11)
SHAPE = 9 * 13, 7 * 11


@pytest.fixture
def matrices(rng: np.random.Generator, tmp_path: Path) -> list[sparse.csr_array]:
    """Three random matrices, also written as red.npz, green.npz and blue.npz."""
    made = [sparse.random_array(SHAPE, density=0.2, rng=rng, dtype=np.float32, format="csr") for _ in CHANNELS]
    for name, matrix in zip(CHANNELS, made, strict=True):
        sparse.save_npz(tmp_path / f"{name}.npz", matrix)
    return made


def arguments(tmp_path: Path, *more: str) -> list[str]:
    channels = [word for name in CHANNELS for word in (f"--{name}", str(tmp_path / f"{name}.npz"))]
    return [*channels, "--camera", "13x9", "--projector", "11x7", "-o", str(tmp_path / "room"), *more]


def refusal(tmp_path: Path, capsys: pytest.CaptureFixture[str], *more: str) -> str:
    """Returns the only line that a refused import prints; checks that it leaves no files."""
    return refusal_here(main, capsys, tmp_path, *arguments(tmp_path, *more))


def test_the_command_keeps_every_entry(
    rng: np.random.Generator, tmp_path: Path, matrices: list[sparse.csr_array]
) -> None:
    ambient = rng.uniform(0, 0.01, (*CAMERA, 3)).astype(np.float32)
    exr.write_rgb(tmp_path / "ambient.exr", ambient)
    more = ("--ambient", str(tmp_path / "ambient.exr"), "--response", "srgb", "--name", "cellar")
    command = [sys.executable, "-m", "counterlight", "import-transport", *arguments(tmp_path, *more)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    counts = ", ".join(f"{name} {matrix.nnz}" for name, matrix in zip(CHANNELS, matrices, strict=True))
    assert re.search(rf"entries: {counts}; \d+\.\d MiB; \d+ of 117 camera pixels in the mask; 0 negative", ended.stdout)
    stored = calibration.read(tmp_path / "room")
    transport = read_transport(stored)
    for found, expected in zip(channels(transport.near), matrices, strict=True):
        np.testing.assert_array_equal(found.toarray(), expected.toarray())
    room = stored.calibration
    np.testing.assert_array_equal(room.ambient, ambient)
    np.testing.assert_array_equal(
        room.mask, lit_pixels(transport.composition().reshape(*CAMERA, 3), ambient.astype(np.float64))
    )
    assert (room.name, room.projector.response, room.camera.shape) == ("cellar", Response("srgb"), CAMERA)
    assert room.provenance == "counterlight import-transport of red.npz, green.npz, blue.npz, ambient.exr"


def test_negative_entries_become_zero_and_are_counted(
    tmp_path: Path, matrices: list[sparse.csr_array], capsys: pytest.CaptureFixture[str]
) -> None:
    green = matrices[1].copy()
    green.data[:5] *= -1
    sparse.save_npz(tmp_path / "green.npz", green)
    assert main(arguments(tmp_path)) == 0
    assert "5 negative entries set to 0 (red 0, green 5, blue 0)" in capsys.readouterr().out
    found = channel(read_transport(calibration.read(tmp_path / "room")).near, 1)
    np.testing.assert_array_equal(found.toarray(), np.maximum(green.toarray(), 0))


def test_duplicate_entries_are_summed(tmp_path: Path, matrices: list[sparse.csr_array]) -> None:
    rows, columns, values = [4, 4, 60], [3, 3, 70], [0.25, 0.5, 1.0]
    sparse.save_npz(tmp_path / "blue.npz", sparse.coo_array((values, (rows, columns)), shape=SHAPE))
    assert main(arguments(tmp_path)) == 0
    found = channel(read_transport(calibration.read(tmp_path / "room")).near, 2)
    assert (found.nnz, found[4, 3], found[60, 70]) == (2, 0.75, 1.0)


def save(matrix: sparse.csr_array, path: Path) -> None:
    sparse.save_npz(path, matrix)


def with_first_entry(value: float) -> Callable[[sparse.csr_array, Path], None]:
    def damage(matrix: sparse.csr_array, path: Path) -> None:
        matrix.data[0] = value
        save(matrix, path)

    return damage


def pickled(matrix: sparse.csr_array, path: Path) -> None:
    np.savez(path, data=np.array([{"a": 1}], dtype=object), format=np.array("csr"), shape=np.array(SHAPE))


def truncated(matrix: sparse.csr_array, path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def bomb(matrix: sparse.csr_array, path: Path) -> None:
    """Write an archive whose directory claims 20 GiB, so that unpacking must not even begin."""
    claimed = (20 << 30) // 8
    with zipfile.ZipFile(path, "w") as archive:
        for i in range(8):
            archive.writestr(f"part{i}.npy", b"0" * 64)
    content = bytearray(path.read_bytes())
    at = 0
    while (at := content.find(b"PK\x01\x02", at)) >= 0:
        content[at + 24 : at + 28] = claimed.to_bytes(4, "little")
        at += 4
    path.write_bytes(content)


def broken_index(matrix: sparse.csr_array, path: Path) -> None:
    matrix.indices[3] = SHAPE[1] + 5
    save(matrix, path)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (with_first_entry(np.nan), r"green\.npz: 1 of \d+ entries are NaN or infinite"),
        (with_first_entry(np.inf), r"green\.npz: 1 of \d+ entries are NaN or infinite"),
        (lambda m, path: save(sparse.csr_array(m.T), path), r"green\.npz: 77x117 entries, expected 117 .* x 77"),
        (lambda m, path: save(sparse.csr_array(SHAPE, dtype=np.float32), path), r"green\.npz: no positive entry"),
        (lambda m, path: save(-m, path), r"green\.npz: no positive entry \(\d+ negative\)"),
        (lambda m, path: save(m.astype(np.complex64), path), r"green\.npz: .*expected real numbers"),
        (pickled, r"green\.npz: no sparse matrix"),
        (truncated, r"green\.npz: no sparse matrix \(File is not a zip file\)"),
        (bomb, r"green\.npz: no sparse matrix \('part0' claims 2684354560 bytes, more than the file can hold\)"),
        (broken_index, r"green\.npz: no sparse matrix"),
        (lambda m, path: path.unlink(), r"green\.npz: missing"),
        (lambda m, path: path.write_bytes(b""), r"green\.npz: no sparse matrix \(File is not a zip file\)"),
    ],
)
def test_bad_matrices_are_refused(
    tmp_path: Path,
    matrices: list[sparse.csr_array],
    capsys: pytest.CaptureFixture[str],
    damage: Callable[[sparse.csr_array, Path], object],
    message: str,
) -> None:
    damage(matrices[1].copy(), tmp_path / "green.npz")
    assert re.search(message, refusal(tmp_path, capsys))


@pytest.mark.parametrize("grey", [False, True])
def test_ambient_light_from_numpy(
    rng: np.random.Generator, tmp_path: Path, matrices: list[sparse.csr_array], grey: bool
) -> None:
    ambient = rng.uniform(0, 0.01, CAMERA if grey else (*CAMERA, 3))
    np.save(tmp_path / "ambient.npy", ambient)
    assert main(arguments(tmp_path, "--ambient", str(tmp_path / "ambient.npy"))) == 0
    found = calibration.read(tmp_path / "room").calibration.ambient
    expected = ambient[..., None] if grey else ambient
    np.testing.assert_array_equal(found, np.broadcast_to(expected, (*CAMERA, 3)).astype(np.float32))


def npy_that_claims_too_much() -> bytes:
    stream = io.BytesIO()
    header = {"descr": "<f4", "fortran_order": False, "shape": (1 << 20, 1 << 20, 3)}
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + b"\0" * 64


def ambient_with(value: float) -> np.ndarray:
    ambient = np.zeros((*CAMERA, 3), np.float64)
    ambient[3, 4, 1] = value
    return ambient


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (ambient_with(np.nan), "1 of 351 values are NaN or infinite"),
        (ambient_with(1e300), "1 of 351 values are NaN or infinite"),
        (ambient_with(-0.1), "1 of 351 values are negative"),
        (np.zeros((13, 9, 3)), "of shape (13, 9, 3), expected real numbers, 9x13x3"),
        (np.zeros((351,)), "of shape (351,), expected real numbers, 9x13x3"),
        (np.zeros((*CAMERA, 3), complex), "complex128 of shape (9, 13, 3), expected real numbers"),
        (np.full((*CAMERA, 3), None), "Python objects, which are never unpickled"),
        (npy_that_claims_too_much(), "claims 13194139533312 bytes, which are not what follows its header"),
        (b"", "a header that is not numpy's"),
    ],
)
def test_bad_ambient_arrays_are_refused(
    tmp_path: Path,
    matrices: list[sparse.csr_array],
    capsys: pytest.CaptureFixture[str],
    content: np.ndarray | bytes,
    message: str,
) -> None:
    path = tmp_path / "ambient.npy"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        np.save(path, content, allow_pickle=True)
    line = refusal(tmp_path, capsys, "--ambient", str(path))
    assert f"{path}: " in line
    assert message in line


@pytest.mark.parametrize(
    ("name", "message"),
    [("absent.npy", "missing"), ("absent.exr", "absent.exr"), ("ambient.png", "read from .exr or .npy")],
)
def test_other_ambient_files_are_refused(
    tmp_path: Path, matrices: list[sparse.csr_array], capsys: pytest.CaptureFixture[str], name: str, message: str
) -> None:
    assert message in refusal(tmp_path, capsys, "--ambient", str(tmp_path / name))


def test_ambient_brighter_than_the_projector_leaves_nothing_lit(
    tmp_path: Path, matrices: list[sparse.csr_array], capsys: pytest.CaptureFixture[str]
) -> None:
    """Ambient light in code values next to T in radiance is refused."""
    np.save(tmp_path / "ambient.npy", np.full((*CAMERA, 3), 1e5))
    line = refusal(tmp_path, capsys, "--ambient", str(tmp_path / "ambient.npy"))
    assert "no camera pixel counts" in line


def test_light_that_is_code_values_is_refused(
    tmp_path: Path, matrices: list[sparse.csr_array], capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "ambient.npy", np.full((*CAMERA, 3), 3, np.uint8))
    assert "ambient light of uint8; expected radiance" in refusal(
        tmp_path, capsys, "--ambient", str(tmp_path / "ambient.npy")
    )
    sparse.save_npz(tmp_path / "red.npz", (255 * matrices[0]).astype(np.uint8))
    assert "red.npz: entries of uint8; expected radiance" in refusal(tmp_path, capsys)


@pytest.mark.parametrize(
    ("ambient", "sign", "complaint"),
    [
        (0.5, 1, ""),
        (20.0, 1, "ambient light is brighter than the projector's white: 20 and .* in the median pixel of the mask"),
        (0.0, -1, r"\d+ negative entries, set to 0, hold \d+ % as much light as the positive"),
    ],
)
def test_doubtful_light_is_warned_of_alike_by_the_command_and_in_python(
    tmp_path: Path,
    matrices: list[sparse.csr_array],
    capsys: pytest.CaptureFixture[str],
    ambient: float,
    sign: int,
    complaint: str,
) -> None:
    matrices[1].data[::2] *= sign
    sparse.save_npz(tmp_path / "green.npz", matrices[1])
    np.save(tmp_path / "ambient.npy", np.full((*CAMERA, 3), ambient))
    assert main(arguments(tmp_path, "--ambient", str(tmp_path / "ambient.npy"))) == 0
    printed = capsys.readouterr().err
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cl.Room.from_matrices(*matrices, camera=CAMERA, projector=PROJECTOR, ambient=ambient, response="srgb")
    said = [str(each.message) for each in caught]
    if not complaint:
        assert (printed, said) == ("", [])
        return
    assert re.search(rf"^warning: .*{complaint}", printed)
    assert len(said) == 1
    assert re.search(complaint, said[0])
    assert caught[0].filename == __file__


def test_a_given_mask_is_kept(tmp_path: Path, matrices: list[sparse.csr_array], rng: np.random.Generator) -> None:
    mask = rng.uniform(size=CAMERA) < 0.5
    cv2.imwrite(str(tmp_path / "mask.png"), mask.astype(np.uint8) * 255)
    assert main(arguments(tmp_path, "--mask", str(tmp_path / "mask.png"))) == 0
    np.testing.assert_array_equal(calibration.read(tmp_path / "room").calibration.mask, mask)


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (np.zeros(CAMERA, np.uint8), "no camera pixel counts"),
        (np.full((13, 9), 255, np.uint8), "9x13, the camera is 13x9"),
        (None, "missing"),
    ],
)
def test_bad_masks_are_refused(
    tmp_path: Path,
    matrices: list[sparse.csr_array],
    capsys: pytest.CaptureFixture[str],
    picture: np.ndarray | None,
    message: str,
) -> None:
    if picture is not None:
        cv2.imwrite(str(tmp_path / "mask.png"), picture)
    assert message in refusal(tmp_path, capsys, "--mask", str(tmp_path / "mask.png"))


def test_a_measured_response_comes_from_a_file(
    tmp_path: Path, matrices: list[sparse.csr_array], capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "projector.toml"
    path.write_text("response = [[0, 0, 0], [0.2, 0.3, 0.4], [1, 1, 1]]")
    assert main(arguments(tmp_path, "--response", str(path))) == 0
    found = calibration.read(tmp_path / "room").calibration.projector.response
    assert found.table == ((0, 0, 0), (0.2, 0.3, 0.4), (1, 1, 1))
    capsys.readouterr()
    for text, message in (("response = [0, 2, 1]", "rises strictly"), ("gamma = 2", "no entry named response")):
        path.write_text(text)
        assert message in refusal(tmp_path, capsys, "--response", str(path), "--force")


def test_a_response_that_nobody_gave_is_srgb_and_said(
    tmp_path: Path, matrices: list[sparse.csr_array], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments(tmp_path)) == 0
    *_, assumed, command = capsys.readouterr().out.splitlines()
    assert assumed.startswith("response: sRGB assumed; measure it with counterlight")
    assert command == f"{tmp_path / 'room'}: imported; next: counterlight build {tmp_path / 'room'}"
    assert calibration.read(tmp_path / "room").calibration.projector.response == Response("srgb")
    assert main(arguments(tmp_path, "--response", "linear", "--force")) == 0
    assert "assumed" not in capsys.readouterr().out
    assert calibration.read(tmp_path / "room").calibration.projector.response == Response("linear")


def test_a_calibration_is_replaced_only_with_force(
    tmp_path: Path, matrices: list[sparse.csr_array], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments(tmp_path)) == 0
    capsys.readouterr()
    assert "--force" in refusal(tmp_path, capsys)
    assert main(arguments(tmp_path, "--force")) == 0


def test_lit_pixels_of_a_spot_with_far_light() -> None:
    """Directly lit pixels, including dark ink, against far light of 3 % and unlit pixels."""
    composition = np.full((20, 31, 3), 0.03)
    composition[:4] = 0
    composition[6:15, 8:22] = np.linspace(0.06, 1, 14)[:, None]
    lit = lit_pixels(composition, np.zeros_like(composition))
    expected = np.zeros((20, 31), bool)
    expected[6:15, 8:22] = True
    np.testing.assert_array_equal(lit, expected)


def test_a_highlight_does_not_hide_the_rest() -> None:
    composition = np.full((40, 50, 3), 0.5)
    composition[7, 9] = 1000
    assert lit_pixels(composition, np.zeros_like(composition)).all()


def test_a_rise_within_the_flicker_of_ambient_light_is_not_lit() -> None:
    composition, ambient = np.full((5, 8, 3), 0.5), np.full((5, 8, 3), 1.0)
    ambient[:, :3] = 40
    np.testing.assert_array_equal(lit_pixels(composition, ambient)[0], [False] * 3 + [True] * 5)


def test_nothing_lit_is_no_error() -> None:
    dark = np.zeros((5, 8, 3), np.float32)
    assert not lit_pixels(dark, dark).any()


def test_no_flipped_bit_of_a_matrix_file_gives_a_traceback(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "T.npz"
    sparse.save_npz(path, sparse.random_array((30, 20), density=0.2, rng=rng, format="csr", dtype=np.float32))
    whole = path.read_bytes()
    for bit in rng.integers(0, 8 * len(whole), 400):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << (bit % 8)
        path.write_bytes(damaged)
        with contextlib.suppress(InputError):
            assert read_matrix(path, (30, 20)).shape == (30, 20)


@pytest.mark.parametrize(
    ("sizes", "complaint"),
    [
        (
            ("--camera", "24x32", "--projector", "24x18"),
            "for camera 24x32 and projector 24x18, .*camera 32x24 and proj",
        ),
        (("--camera", "32x24", "--projector", "18x24"), "for camera 32x24 and projector 18x24, .*projector 24x18, 0"),
        (("--camera", "32x24", "--projector", "24x18"), ""),
    ],
)
def test_swapped_sizes_are_imported_with_a_warning(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str], sizes: tuple[str, ...], complaint: str
) -> None:
    for name in CHANNELS:
        sparse.save_npz(tmp_path / f"{name}.npz", smooth(rng, (24, 32), (18, 24)))
    assert main([*arguments(tmp_path), *sizes]) == 0
    printed = capsys.readouterr().err
    if not complaint:
        assert printed == ""
        return
    assert re.fullmatch(rf"warning: T looks scrambled {complaint}.*WIDTHxHEIGHT.*\n", printed)
