"""counterlight merge-exposures as a user runs it: the picture, the response file, EXIF, one-line refusals."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from counterlight.files.exr import read_rgb
from counterlight.response import named_response
from counterlight.tools.hdr.camera_response import exposure_table
from counterlight.tools.merge_exposures import main
from tests.brackets import CURVES, codes_of, random_scene, write_bracket, write_picture
from tests.programs import refusal_here

TIMES = [0.25, 1.0, 4.0, 16.0, 64.0]
TEXT = [str(t) for t in TIMES]


@pytest.fixture
def scene(rng: np.random.Generator) -> np.ndarray:
    return random_scene(rng, (120, 176, 3))


@pytest.fixture
def bracket(scene: np.ndarray, tmp_path: Path) -> list[str]:
    return write_bracket(tmp_path / "bracket", scene, TIMES, CURVES["srgb"])


def refusal(capsys: pytest.CaptureFixture[str], folder: Path, *arguments: str) -> str:
    """Return the one-line error of a refused merge, and check that no file is left behind."""
    output = () if "-o" in arguments else ("-o", str(folder / "out.exr"))
    return refusal_here(main, capsys, folder, *arguments, *output)


@pytest.mark.parametrize("options", [(), ("--method", "robertson"), ("--weighting", "gaussian")])
def test_the_command_recovers_the_response_and_the_light(
    bracket: list[str], scene: np.ndarray, tmp_path: Path, options: tuple[str, ...]
) -> None:
    output, curve = tmp_path / "out.exr", tmp_path / "camera.toml"
    arguments = [*bracket, "--times", *TEXT, *options, "--save-response", str(curve), "-o", str(output)]
    ended = subprocess.run(
        [sys.executable, "-m", "counterlight", "merge-exposures", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert re.search(r"176x120, 5 pictures of 0\.25 to 64 s, .* response recovered \(debevec\), CPU: ", ended.stdout)
    found = exposure_table(named_response(str(curve)), 256, 3)
    # the same bound as in test_hdr.py
    np.testing.assert_allclose(found[16:250], exposure_table(CURVES["srgb"], 256, 3)[16:250], rtol=0.05)
    ratio = read_rgb(output) / scene
    # A channel's scale is known only up to its curve, 5 %. Quantisation adds the rest: the darkest pixels have ten
    # codes.
    assert np.abs(ratio / np.median(ratio, axis=(0, 1)) - 1).max() < 0.08
    np.testing.assert_allclose(np.median(ratio, axis=(0, 1)), 1, atol=0.05)


def test_a_saved_response_gives_the_same_picture(bracket: list[str], tmp_path: Path) -> None:
    curve, first, second = (str(tmp_path / name) for name in ("camera.toml", "first.exr", "second.exr"))
    assert main([*bracket, "--times", *TEXT, "--save-response", curve, "-o", first]) == 0
    assert main([*bracket, "--times", *TEXT, "--response", curve, "-o", second]) == 0
    np.testing.assert_array_equal(read_rgb(Path(first)), read_rgb(Path(second)))


def test_grey_sixteen_bit_pictures_of_a_linear_camera(rng: np.random.Generator, tmp_path: Path) -> None:
    light = random_scene(rng, (30, 50, 1), decades=2)
    names = write_bracket(tmp_path, light, [0.5, 4.0], CURVES["linear"], top=65535)
    times = ["1/2", "4"]
    assert main([*names, "--times", *times, "--response", "linear", "-o", str(tmp_path / "out.exr")]) == 0
    merged = read_rgb(tmp_path / "out.exr")
    np.testing.assert_allclose(merged, light.repeat(3, axis=2), rtol=2e-3)  # half a code of at least 327


def test_the_gpu_gives_the_same_picture(bracket: list[str], tmp_path: Path) -> None:
    """The tolerance that docs/hdr.md states."""
    for method in ("debevec", "robertson"):
        arguments = [*bracket, "--times", *TEXT, "--response", "srgb", "--method", method]
        for name, options in (("cpu", []), ("gpu", ["--gpu"])):
            assert main([*arguments, *options, "-o", str(tmp_path / f"{name}.exr")]) == 0
        np.testing.assert_allclose(read_rgb(tmp_path / "gpu.exr"), read_rgb(tmp_path / "cpu.exr"), rtol=1e-5)


def test_shots_of_one_exposure_are_averaged(rng: np.random.Generator, tmp_path: Path) -> None:
    shots = [rng.integers(10, 240, (6, 9, 3), dtype=np.uint8) for _ in range(3)]
    names = [str(write_picture(tmp_path / f"{i}.png", shot)) for i, shot in enumerate(shots)]
    output = tmp_path / "out.exr"
    arguments = [*names, "--times", *["0.1"] * 3, "--method", "average", "--response", "linear"]
    assert main([*arguments, "-o", str(output)]) == 0
    np.testing.assert_allclose(read_rgb(output), np.mean(shots, axis=0) / 255 / 0.1, rtol=3e-7)  # rounding to float32


def write_exif(path: Path, codes: np.ndarray, tags: dict[int, object]) -> str:
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif).update(tags)
    Image.fromarray(codes).save(path, exif=exif.tobytes())
    return str(path)


EXPOSURE, APERTURE, ISO = (ExifTags.Base[name].value for name in ("ExposureTime", "FNumber", "ISOSpeedRatings"))


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_times_come_from_exif(scene: np.ndarray, tmp_path: Path, suffix: str) -> None:
    names = []
    for i, t in enumerate(TIMES):
        tags = {EXPOSURE: t, APERTURE: 8.0, ISO: 100}
        names.append(write_exif(tmp_path / f"{i}{suffix}", codes_of(scene, t, CURVES["srgb"]), tags))
    read, given = tmp_path / "read.exr", tmp_path / "given.exr"
    assert main([*names, "--response", "srgb", "-o", str(read)]) == 0
    assert main([*names, "--response", "srgb", "--times", *TEXT, "-o", str(given)]) == 0
    np.testing.assert_array_equal(read_rgb(read), read_rgb(given))


@pytest.mark.parametrize(
    ("first", "second", "line"),
    [
        ({}, {}, r"a\.jpg: no exposure time in its EXIF; give --times"),
        ({EXPOSURE: 1.0}, {APERTURE: 8.0}, r"b\.jpg: no exposure time in its EXIF; give --times"),
        (
            {EXPOSURE: 1.0, APERTURE: 8.0},
            {EXPOSURE: 2.0, APERTURE: 4.0},
            r"b\.jpg: aperture f/4, expected aperture f/8",
        ),
        ({EXPOSURE: 1.0, ISO: 100}, {EXPOSURE: 2.0, ISO: 400}, r"b\.jpg: ISO 400, expected ISO 100 as in a\.jpg"),
        ({EXPOSURE: 1.0}, {EXPOSURE: 1.0}, r"a\.jpg and the others: all 1 s, expected a bracket .* --method average"),
        ({EXPOSURE: 0.0}, {EXPOSURE: 1.0}, r"a\.jpg: no exposure time in its EXIF"),
    ],
)
def test_exif_that_does_not_say_the_exposure(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    first: dict[int, object],
    second: dict[int, object],
    line: str,
) -> None:
    codes = np.full((8, 8, 3), 100, np.uint8)
    names = [write_exif(tmp_path / name, codes, tags) for name, tags in (("a.jpg", first), ("b.jpg", second))]
    assert re.search(line, refusal(capsys, tmp_path, *names))


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["0", "--times", "1"], r"shot00\.png: one picture, expected at least two"),
        (["01", "--times", "1"], r"--times: 1 times for 2 pictures"),
        (["01", "--times", "1", "0"], r"--times: 0 s, expected positive times"),
        (["01", "--times", "1", "1/0"], r"such as 0\.125 or 1/8, found '1/0'"),
        (["01", "--times", "1", "1"], r"all 1 s, expected a bracket"),
        (["10", "--times", "0.25", "1"], r"shot00\.png: 1 s, darker than shot01\.png with 0\.25 s; give the times in"),
        (["00", "--times", "0.25", "1"], r"equally bright with 0\.25 to 1 s; the camera did not follow"),
        (["01"], r"shot00\.png: no exposure time in its EXIF"),
        (["01", "--method", "average", "--times", "1", "1"], r"--method average: .* name the response"),
        (
            ["01", "--method", "average", "--response", "linear", "--times", "1", "2"],
            r"1 to 2 s, expected shots of one",
        ),
        (
            ["01", "--method", "average", "--weighting", "hat", "--times", "1", "1"],
            r"--weighting hat: .* leave one out",
        ),
        (["01", "--response", "srbg", "--times", "1", "4"], r"response 'srbg'"),
        (["01", "--times", "1", "4", "-o", "out.png"], r"out\.png: a radiance map is written as OpenEXR"),
    ],
)
def test_wrong_use_is_refused(
    capsys: pytest.CaptureFixture[str], bracket: list[str], tmp_path: Path, arguments: list[str], line: str
) -> None:
    names = [bracket[int(digit)] for digit in arguments[0]]
    assert re.search(line, refusal(capsys, tmp_path, *names, *arguments[1:]))


def pictures(*codes: np.ndarray) -> Callable[[Path], list[str]]:
    return lambda folder: [str(write_picture(folder / f"{i}.png", picture)) for i, picture in enumerate(codes)]


GOOD = np.full((8, 8, 3), 100, np.uint8)


@pytest.mark.parametrize(
    ("write", "line"),
    [
        (pictures(GOOD, GOOD[:, :7]), r"1\.png: 7x8 colour 8-bit, expected 8x8 colour 8-bit as in 0\.png"),
        (pictures(GOOD, GOOD[..., :1]), r"1\.png: 8x8 grey 8-bit, expected 8x8 colour 8-bit"),
        (pictures(GOOD, GOOD.astype(np.uint16)), r"1\.png: 8x8 colour 16-bit, expected 8x8 colour 8-bit"),
        (pictures(GOOD // 200, GOOD // 200), r"100\.0% of the values are black even in the longest exposure"),
        (pictures(GOOD | 255, GOOD | 255), r"100\.0% of the values are saturated even in the shortest exposure"),
        (lambda folder: [str(folder / "none.png")] * 2, r"none\.png: missing"),
    ],
)
def test_useless_pictures_are_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, write: Callable[[Path], list[str]], line: str
) -> None:
    names = write(tmp_path)
    assert re.search(line, refusal(capsys, tmp_path, *names, "--times", "1", "4", "--response", "linear"))


def test_a_useless_bracket_does_not_show_the_response(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    names = pictures(GOOD | 255, GOOD | 255)(tmp_path)
    assert "shows 0 code values" in refusal(capsys, tmp_path, *names, "--times", "1", "4")


def test_a_coloured_response_does_not_fit_a_grey_camera(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    curve = tmp_path / "camera.toml"
    curve.write_text("response = [[0, 0, 0], [1, 1, 1]]")
    names = pictures(GOOD[..., :1], GOOD[..., :1] * 2)(tmp_path)
    line = refusal(capsys, tmp_path, *names, "--times", "1", "2", "--response", str(curve))
    assert "a table of 3 columns, the pictures are grey" in line


def test_a_truncated_picture_is_refused(capsys: pytest.CaptureFixture[str], bracket: list[str], tmp_path: Path) -> None:
    path = Path(bracket[2])
    path.write_bytes(path.read_bytes()[:-30])
    assert re.search(r"shot02\.png: .*truncated", refusal(capsys, tmp_path, *bracket, "--times", *TEXT))
    path.write_bytes(b"")
    assert re.search(r"shot02\.png: neither PNG nor JPEG", refusal(capsys, tmp_path, *bracket, "--times", *TEXT))
