"""Colour tables: read and interpolated as colour-science does; damaged files are refused in one line."""

from collections.abc import Callable
from pathlib import Path

import colour
import numpy as np
import pytest
from colour.algebra import table_interpolation_tetrahedral

from counterlight.errors import InputError
from counterlight.files.cube import MAX_BYTES, Cube, read_cube
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.signal import signal_of
from tests.cubes import write_cube
from tests.oracles.formulas import planes_to_linear, tetrahedral
from tests.programs import fail
from tests.rooms import rgb_frame, yuv_frame

TABLE = 2e-6  # error of a transfer table of 1024 samples


def identity(size: int) -> Cube:
    axis = np.linspace(0, 1, size, dtype=np.float32)
    blue, green, red = np.meshgrid(axis, axis, axis, indexing="ij")
    return Cube(Path("identity"), np.stack([red, green, blue], axis=-1), np.zeros(3), np.ones(3))


@pytest.mark.parametrize("size", [2, 17, 33, 65])
@pytest.mark.parametrize("domain", [((0, 0, 0), (1, 1, 1)), ((-0.1, 0, 0.05), (1.2, 0.9, 1))])
def test_a_table_is_read_and_interpolated_as_colour_science_does(
    rng: np.random.Generator, size: int, domain: tuple[tuple[float, ...], tuple[float, ...]], tmp_path: Path
) -> None:
    path = write_cube(tmp_path / "look.cube", rng, size, domain)
    codes = rng.uniform(-0.1, 1.1, (500, 3))
    codes[:40] = codes[:40, :1]  # on the grey diagonal, where the tetrahedra meet
    theirs = colour.read_LUT(str(path))
    low, high = np.array(domain)
    inside = np.clip((codes - low) / (high - low), 0, 1)
    expected = table_interpolation_tetrahedral(inside, theirs.table)
    # the file has six digits; rounding to float32
    np.testing.assert_allclose(tetrahedral(read_cube(path), codes), expected, atol=1e-6)


def test_the_identity_changes_nothing(rng: np.random.Generator) -> None:
    codes = rng.uniform(size=(300, 3))
    np.testing.assert_allclose(tetrahedral(identity(17), codes), codes, atol=1e-7)  # the samples are float32


def test_a_linear_table_is_exact_between_samples(rng: np.random.Generator) -> None:
    mix = rng.uniform(size=(3, 3))
    cube = Cube(Path("mix"), (identity(5).table @ mix.T).astype(np.float32), np.zeros(3), np.ones(3))
    codes = rng.uniform(size=(300, 3))
    np.testing.assert_allclose(tetrahedral(cube, codes), codes @ mix.T, atol=3e-7)


def test_codes_of_a_picture_go_through_it(rng: np.random.Generator, tmp_path: Path) -> None:
    """The table applies after the viewer's brightness and before the medium's curve."""
    cube = read_cube(write_cube(tmp_path / "look.cube", rng, 9))
    frame = rgb_frame(rng.integers(0, 256, (7, 9, 3)).astype(np.uint8), "linear")
    codes = np.clip(np.stack(frame.planes, axis=-1) / 255 + 0.1, 0, 1)
    signal = signal_of(frame.format, Adjustments(brightness=10, lut=cube))
    expected = np.clip(tetrahedral(cube, codes), 0, 1)
    np.testing.assert_allclose(planes_to_linear(frame.planes, frame.format, signal), expected, atol=TABLE)


def test_a_conversion_makes_an_ordinary_picture_of_hdr(rng: np.random.Generator) -> None:
    """With an identity table of type `conversion`, the player reads PQ codes as BT.1886 codes."""
    frame = yuv_frame(rng, (8, 12), transfer="pq", primaries="bt2020", matrix="bt2020", depth=10)
    native, conversion = (
        planes_to_linear(frame.planes, frame.format, signal_of(frame.format, adjustments))
        for adjustments in (Adjustments(lut=identity(2)), Adjustments(lut=identity(2), lut_type="conversion"))
    )
    plain = planes_to_linear(frame.planes, frame.format, signal_of(frame.format, NEUTRAL))
    np.testing.assert_allclose(native, plain, atol=1e-5)  # float32 codes, where PQ is steep
    ordinary = yuv_frame(np.random.default_rng(1), (8, 12), matrix="bt2020", depth=10).format
    expected = planes_to_linear(frame.planes, ordinary, signal_of(ordinary))
    np.testing.assert_allclose(conversion, expected, atol=1e-6)


def test_resolve_s_words_and_comments_are_understood(tmp_path: Path) -> None:
    path = tmp_path / "look.cube"
    rows = "\n".join(f"{i} {i} {i} # {i}" for i in range(8))
    path.write_text(
        f'\ufeff# made by hand\nTITLE "ünïcode"\n\nLUT_3D_SIZE 2\nLUT_3D_INPUT_RANGE -1 2\n{rows}\n\n# end\n'
    )
    cube = read_cube(path)
    assert (cube.low.tolist(), cube.high.tolist()) == ([-1] * 3, [2] * 3)
    np.testing.assert_array_equal(cube.table.reshape(-1, 3)[:, 0], range(8))


def lines(*head: str, rows: int = 8, row: str = "0 0 0") -> str:
    return "\n".join([*head, *[row] * rows])


BAD: dict[str, tuple[str | bytes, str]] = {
    "nothing": ("", "no line LUT_3D_SIZE"),
    "no text": (bytes(range(256)) * 40, "no line LUT_3D_SIZE"),
    "one dimension": (lines("LUT_1D_SIZE 8"), "one dimension; bake it into one of three"),
    "both": (lines("LUT_1D_SIZE 4", "LUT_3D_SIZE 2"), "one dimension"),
    "cut off": (lines("LUT_3D_SIZE 2", rows=7), "7 colours, LUT_3D_SIZE 2 promises 8"),
    "too long": (lines("LUT_3D_SIZE 2", rows=9), "9 colours"),
    "no colours": ("LUT_3D_SIZE 2\n", "0 colours"),
    "too large": (lines("LUT_3D_SIZE 66"), "expected 2 to 65, found '66'"),
    "one sample": (lines("LUT_3D_SIZE 1", rows=1), "expected 2 to 65, found '1'"),
    "endless": (lines(f"LUT_3D_SIZE {'9' * 5000}"), "expected 2 to 65, found '9999"),
    "no size": (lines("LUT_3D_SIZE"), "expected 2 to 65, found ''"),
    "half a line": (lines("LUT_3D_SIZE 2", "0 0 0", "0 0"), "line 3: expected three numbers, found '0 0'"),
    "four": (lines("LUT_3D_SIZE 2", row="0 0 0 0"), "line 2: expected three numbers, found '0 0 0 0'"),
    "a word": (lines("LUT_3D_SIZE 2", "0 0 0", "0 x 0"), "line 3: expected three numbers, found '0 x 0'"),
    "nan": (lines("LUT_3D_SIZE 2", "0 0 0", "0 nan 0"), "line 3: expected three numbers, found '0 nan 0'"),
    "infinite": (lines("LUT_3D_SIZE 2", "0 1e39 0"), "line 2: expected three numbers, found '0 1e39 0'"),
    "a domain's end": (lines("LUT_3D_SIZE 2", "DOMAIN_MAX 1 1"), "line 2: DOMAIN_MAX: expected numbers, found '1 1'"),
    "a domain upside down": (lines("LUT_3D_SIZE 2", "DOMAIN_MIN 0 1 0"), "its domain ends at"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_refused_in_a_line(name: str, tmp_path: Path) -> None:
    content, message = BAD[name]
    path = tmp_path / "look.cube"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as refusal:
        read_cube(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_no_more_is_read_than_a_table_holds(tmp_path: Path) -> None:
    path = tmp_path / "look.cube"
    with path.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    with pytest.raises(InputError, match=f"more than the {MAX_BYTES} bytes"):
        read_cube(path)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, "missing"),
        (lambda path: path.mkdir(), "a folder, expected a regular file"),
        (lambda path: path.write_text("LUT_3D_SIZE 2\n0 0 0\n"), "1 colours, LUT_3D_SIZE 2 promises 8"),
    ],
)
def test_the_command_ends_with_that_line(make: Callable[[Path], object], message: str, tmp_path: Path) -> None:
    make(tmp_path / "look.cube")
    line = fail("play", tmp_path, "clip.mkv", "--lut", tmp_path / "look.cube", "--output", tmp_path / "out.png")
    assert message in line
    assert not (tmp_path / "out.png").exists()
