"""A projector's response: known curves, a measured projector, predicted photographs."""

import json
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.files.exr import write_rgb
from counterlight.files.reading import read_toml
from counterlight.response import Response, named_response, projector_response
from counterlight.tools.acquisition.captures import find_captures
from counterlight.tools.acquisition.graycode import Decoded, decode
from counterlight.tools.acquisition.graycode_room import GraycodeOptions, import_graycode_room
from counterlight.tools.fit_projector_response import main
from counterlight.tools.hdr.projector_response import fit_projector_response
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import channel
from tests.brackets import CURVES, write_picture
from tests.oracles.encoding import encode
from tests.programs import ROOT

LEVELS = np.arange(0, 256, 5) / 255
GREY = Response("linear")


def level_means(codes: np.ndarray, light: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the arguments of `fit_projector_response`: levels, mean light (levels, 1) and counts.

    codes : (pixels,). Code that the projector showed.
    light : (pixels,). Light relative to the pixel's own white.
    """
    counts = np.bincount(codes, minlength=256)
    shown = np.flatnonzero(counts)
    means = np.bincount(codes, light, 256)[shown] / counts[shown]
    return shown / 255, means[:, None], counts[shown].astype(np.float64)


def curve_of(response: Response, codes: np.ndarray) -> np.ndarray:
    """Return a curve's light, (codes, 3)."""
    return response.to_linear(codes[:, None].repeat(3, axis=1))


def readings_of(response: Response, black: np.ndarray, white: np.ndarray) -> np.ndarray:
    return black + (white - black) * curve_of(response, LEVELS)


@pytest.mark.parametrize("name", list(CURVES))
def test_a_known_curve_comes_back(name: str) -> None:
    black, white = np.array([0.1, 0.2, 0.3]), np.array([10.0, 40.0, 20.0])
    fitted = fit_projector_response(LEVELS, readings_of(CURVES[name], black, white))
    assert fitted.black_level == pytest.approx(black / white)
    assert fitted.pooled < 1e-12
    codes = np.linspace(0, 1, 256)
    # Cubics through every fifth level. The bend of sRGB in the darkest thirtieth is the hardest part.
    np.testing.assert_allclose(curve_of(fitted.response, codes), curve_of(CURVES[name], codes), atol=1e-3)


def test_noise_is_pooled_and_repeats_are_averaged(rng: np.random.Generator) -> None:
    readings = readings_of(CURVES["srgb"], np.full(3, 0.5), np.full(3, 90.0))
    noisy = np.concatenate([readings + rng.normal(0, 0.3, readings.shape) for _ in range(4)])
    order = rng.permutation(len(noisy))
    fitted = fit_projector_response(np.tile(LEVELS, 4)[order], noisy[order])
    table = np.array(fitted.response.table)
    assert np.diff(table, axis=0).min() > 0
    assert 0 < fitted.pooled < 0.01  # a third of a percent, halved by four repeats; differences of two readings
    codes = np.linspace(0, 1, 256)
    # five standard deviations of the noise
    np.testing.assert_allclose(table, curve_of(CURVES["srgb"], codes), atol=0.008)


@pytest.mark.parametrize(
    ("levels", "light", "line"),
    [
        ([0, 0.5, 1], [0, 1, 2], "3 different levels, expected at least 5"),
        ([0, 0.2, 0.4, 0.6, 0.8], [0, 1, 2, 3, 4], "levels 0 to 204 of 255, expected 0 to 255"),
        ([0, 0.2, 0.4, 0.6, 1], [4, 3, 2, 1, 0], "white is no brighter than black"),
        ([0, 0.2, 0.4, 0.6, 1], [0, 1, 2, 3, np.nan], "white is no brighter than black"),
    ],
)
def test_ramps_that_show_no_response(levels: list[float], light: list[float], line: str) -> None:
    with pytest.raises(InputError, match=line):
        fit_projector_response(np.array(levels), np.array(light)[:, None])


def write_table(path: Path, levels: np.ndarray, readings: np.ndarray) -> Path:
    names = "level,red,green,blue" if readings.shape[1] == 3 else "level,grey"
    rows = [",".join(map(repr, map(float, (level, *row)))) for level, row in zip(levels, readings, strict=True)]
    path.write_text("\n".join([names, *rows]) + "\n")
    return path


def test_the_command_fits_a_table(tmp_path: Path) -> None:
    readings = readings_of(CURVES["film"], np.zeros(3) + 1, np.array([100.0, 200.0, 50.0]))
    table = write_table(tmp_path / "ramp.csv", LEVELS * 255, readings)
    output = tmp_path / "projector.toml"
    ended = subprocess.run(
        [sys.executable, "-m", "counterlight", "fit-response", str(table), "-o", str(output)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert re.search(r"52 readings, black level 1\.00%, 0\.50%, 2\.00% of white", ended.stdout)
    assert read_toml(output, "")["black_level"] == pytest.approx([0.01, 0.005, 0.02])
    codes = np.linspace(0, 1, 256)
    found = curve_of(named_response(str(output)), codes)
    np.testing.assert_allclose(found, curve_of(CURVES["film"], codes), atol=1e-4)  # cubics approximate a smooth curve


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_the_command_fits_pictures(tmp_path: Path, suffix: str) -> None:
    """The projector lights the middle of the view. The camera encodes as sRGB, or its brackets were merged."""
    folder = tmp_path / "ramp"
    folder.mkdir()
    for level in range(0, 256, 15):
        light = np.full((20, 30, 3), 0.02)
        light[5:15, 10:25] = 0.02 + 0.9 * (level / 255) ** 2.2
        if suffix == ".exr":
            write_rgb(folder / f"ramp_{level:03}.exr", light.astype(np.float32))
        else:
            codes = np.interp(light, curve_of(CURVES["srgb"], np.linspace(0, 1, 65536))[:, 0], np.arange(65536.0))
            write_picture(folder / f"ramp_{level:03}.png", np.rint(codes).astype(np.uint16))
    output = tmp_path / "projector.toml"
    assert main([str(folder), "--camera-response", "srgb", "-o", str(output)]) == 0
    assert read_toml(output, "")["black_level"] == pytest.approx([0.02 / 0.92] * 3, rel=1e-4)
    codes = np.linspace(0, 1, 256)
    found = curve_of(named_response(str(output)), codes)
    np.testing.assert_allclose(found, codes[:, None].repeat(3, axis=1) ** 2.2, atol=2e-3)  # cubics over 15 levels


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", r"columns none; expected columns level,red,green,blue"),
        ("level,grey\n", r"no readings"),
        ("code,grey\n0,1\n", r"columns 'code,grey'; expected"),
        ("level,grey\n0,1\n5,x\n", r"ramp\.csv:3: '5,x', expected 2 numbers"),
        ("level,grey\n0,1\n5,1,2\n", r"ramp\.csv:3: '5,1,2', expected 2 numbers"),
        ("level,grey\n0,1\n256,2\n", r"ramp\.csv:3: '256,2'"),
        ("level,grey\n0,1\n255,nan\n", r"ramp\.csv:3: '255,nan'"),
        ("level,grey\n0,1\n255,2\n", r"2 different levels"),
    ],
)
def test_tables_that_cannot_be_read(capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, line: str) -> None:
    path = tmp_path / "ramp.csv"
    path.write_text(text)
    assert main([str(path), "-o", str(tmp_path / "out.toml")]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    assert re.search(line, printed)
    assert not (tmp_path / "out.toml").exists()


def grey(value: int, width: int = 6) -> np.ndarray:
    return np.full((4, width, 1), value, np.uint8)


@pytest.mark.parametrize(
    ("pictures", "line"),
    [
        ({}, r"0 pictures, none of level 0; .* ramp_000\.png"),
        ({"a_000": grey(0), "a_100": grey(100)}, r"2 pictures, none of level 255"),
        ({"a_000": grey(0), "b_0": grey(1)}, r"b_0\.png: shows level 0, as a_000\.png"),
        ({"a_000": grey(0), "a_300": grey(1)}, r"a_300\.png: shows level 300, beyond 255"),
        ({"a_000": grey(0), "a_255": grey(255)}, r"a_255\.png: 100\.0% of the lit pixels are saturated"),
        ({"a_000": grey(0, 5), "a_255": grey(200)}, r"a_000\.png: another size than a_255\.png"),
        ({"a_000": grey(0), "a_100": grey(9, 5), "a_255": grey(200)}, r"a_100\.png: another size than a_255\.png"),
    ],
)
def test_folders_that_show_no_ramp(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, pictures: dict[str, np.ndarray], line: str
) -> None:
    folder = tmp_path / "ramp"
    folder.mkdir()
    for name, codes in pictures.items():
        write_picture(folder / f"{name}.png", codes)
    assert main([str(folder), "-o", str(tmp_path / "out.toml")]) == 2
    assert re.search(line, capsys.readouterr().err)


def test_a_measured_projector_is_linearised(shared_data: Path, tmp_path: Path) -> None:
    """The response of a DLP projector is fitted to every second level. Inverted, it linearises the other levels."""
    folder = shared_data / "projector-response-scannersim"
    if not folder.is_dir():
        pytest.skip("no shared data beside this checkout")
    measured = [json.loads((folder / f"{name}.json").read_text()) for name in ("red", "green", "blue")]
    levels = np.array(measured[0]["ids"], np.float64)
    readings = np.stack([channel["signal"] for channel in measured], axis=1)
    known = np.r_[0 : len(levels) : 2, len(levels) - 1]
    table = write_table(tmp_path / "ramp.csv", levels[known], readings[known])
    assert main([str(table), "-o", str(tmp_path / "projector.toml")]) == 0
    response = named_response(str(tmp_path / "projector.toml"))
    relative = (readings - readings[0]) / (readings[-1] - readings[0])
    error = np.abs(curve_of(response, levels / 255) - relative)
    assert np.percentile(error, 95) < 0.005
    assert error.max() < 0.02  # the curve has a step at level 215, and no remaining reading shows it
    light = np.linspace(0, 1, 200)[None, :, None].repeat(3, axis=2)
    codes = encode(light, response.inverse_table())[0].astype(np.float64)
    shown = np.stack([np.interp(codes[:, i], levels, relative[:, i]) for i in range(3)], axis=1)
    assert np.abs(shown - light[0]).max() < 0.02  # the step at level 215, plus half a code


def test_scenes_and_fitted_responses_read_each_other(tmp_path: Path) -> None:
    """A scene accepts the output of fit-response, and --response accepts the response of a scene or a room."""
    readings = readings_of(CURVES["film"], np.zeros(3), np.array([100.0, 200.0, 50.0]))
    table = write_table(tmp_path / "ramp.csv", LEVELS * 255, readings)
    fitted = tmp_path / "projector.toml"
    assert main([str(table), "-o", str(fitted)]) == 0
    text = (ROOT / "calib_data" / "scenes" / "wall.toml").read_text()
    assert text.count('response = "srgb"') == 1
    scene = tmp_path / "wall.toml"
    scene.write_text(text.replace('response = "srgb"', 'response = "projector.toml"'))
    response = named_response(str(fitted))
    assert load_scene(scene).projector.response == response
    assert projector_response(str(scene)) == response
    assert projector_response(str(fitted)) == response
    devices = (Device(3, 4, response),), Device(2, 5, GREY)
    room = Calibration("room", "", *devices, np.zeros((2, 5, 3), np.float32), np.ones((2, 5), bool))
    with calibration.writing(tmp_path / "room", room):
        pass
    assert projector_response(str(tmp_path / "room" / "calibration.toml")) == response
    (tmp_path / "empty.toml").write_text("gamma = 2")
    with pytest.raises(InputError, match=r"empty\.toml: has no entry named response; a response file holds"):
        projector_response(str(tmp_path / "empty.toml"))


SINES = [(axis, phase) for axis in "xy" for phase in range(3)]


def sine(axis: str, phase: int) -> np.ndarray:
    """Return the projected picture, (1080, 1920) uint8, by the formula in the data's README."""
    rows, columns = np.mgrid[:1080, :1920]
    angle = 2 * np.pi * (columns if axis == "x" else rows) / 240 + (phase - 1) * 2 * np.pi / 3
    value = 255 * (0.5 * (np.cos(angle) + 1)) ** (1 / 0.75)
    return (np.round(value) if axis == "x" else np.floor(value)).astype(np.uint8)


def relative_readings(folder: Path, decoded: Decoded, trusted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return code and light relative to white, of the trusted pixels in the three pictures along x."""
    black, white = decoded.black[..., 0][trusted], decoded.white[..., 0][trusted]
    codes, light = [], []
    for phase in range(3):
        picture = cv2.imread(str(folder / f"sine_x_gamma0.75_phase{phase}.png"), cv2.IMREAD_GRAYSCALE)
        codes.append(sine("x", phase)[2 * decoded.y[trusted] + 1, 2 * decoded.x[trusted] + 1])
        light.append((picture[trusted] / 255 - black) / (white - black))
    return np.concatenate(codes), np.concatenate(light)


def test_photographs_are_predicted_from_response_and_transport(shared_data: Path, tmp_path: Path) -> None:
    """T comes from Gray code, the response from pictures along x.

    The predicted pictures, along y, were used for neither.
    """
    folder = shared_data / "projector-response-kamino"
    if not folder.is_dir():
        pytest.skip("no shared data beside this checkout")
    decoded = decode(find_captures(folder, (540, 960)), GREY)
    trusted = decoded.valid((540, 960), 5.0)
    assert trusted.mean() > 0.7
    levels, means, counts = level_means(*relative_readings(folder, decoded, trusted))
    ends = counts.sum() * np.ones(1)  # black.png and white.png, which define 0 and 1
    fitted = fit_projector_response(
        np.concatenate([[0], levels, [1]]),
        np.concatenate([[[0]], means, [[1]]]),
        np.concatenate([1e3 * ends, counts, 1e3 * ends]),
    )
    room = tmp_path / "room"
    import_graycode_room(folder, room, GraycodeOptions(Device(1080, 1920, fitted.response), GREY, step=2))
    stored = calibration.read(room)
    T, mask = channel(read_transport(stored).near, 0), stored.calibration.mask
    for axis, phase in SINES:
        drive = fitted.response.to_linear(sine(axis, phase)[..., None].repeat(3, axis=2) / 255.0)[..., 0]
        predicted = (T @ drive.ravel()).reshape(mask.shape) + stored.calibration.ambient[..., 0]
        picture = cv2.imread(str(folder / f"sine_{axis}_gamma0.75_phase{phase}.png"), cv2.IMREAD_GRAYSCALE)
        error = np.abs(255 * predicted - picture)[mask]
        assert error.mean() <= 3
