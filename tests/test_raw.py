"""Camera RAW: sensor values come back unchanged, clipping is seen, damage is refused, brackets are merged."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rawpy

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.files.exr import read_rgb
from counterlight.response import Response, named_response
from counterlight.tools import acquire_transport, fit_projector_response, merge_exposures
from counterlight.tools.acquisition.cameras.camera import Exposures
from counterlight.tools.acquisition.cameras.folder import FolderCamera
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, simulated_rooms
from counterlight.tools.acquisition.cameras.tethered import TetheredDevice
from counterlight.tools.hdr.photographs import read_photograph
from counterlight.tools.hdr.raw_files import TOP, decode_raw
from counterlight.tools.transport.storage import read_transport
from tests.acquired_rooms import CAMERA, PROJECTOR, shown_by
from tests.dng import RGGB, XTRANS, dng, mosaic_of
from tests.rooms import write_blurred_room

BLACK, WHITE = (508, 512, 516, 520), 15872
SCALE = TOP / (WHITE - np.array(BLACK))
HALF = 0.5 + 1 / 128  # code values: rounding, and float32 sums up to 2¹⁶


@pytest.fixture
def mosaic(rng: np.random.Generator) -> np.ndarray:
    """Return sensor values below the white level, some below black, with unequal odd sides."""
    return rng.integers(400, WHITE, (37, 51)).astype(np.uint16)


def test_each_quad_is_a_pixel_of_the_sensors_own_light(mosaic: np.ndarray) -> None:
    codes = decode_raw(dng(mosaic, black=BLACK, white=WHITE), "shot.dng")
    assert (codes.shape, codes.dtype) == ((18, 25, 3), np.uint16)
    sites = mosaic[:36, :50].astype(np.float64)
    red, green_of_red, green_of_blue, blue = (
        (sites[y::2, x::2] - BLACK[2 * y + x]) * SCALE[2 * y + x] for y, x in np.ndindex(2, 2)
    )
    expected = np.stack([red, (green_of_red + green_of_blue) / 2, blue], axis=-1)
    assert np.abs(codes - expected.clip(0, TOP)).max() <= HALF


def test_no_white_balance_and_no_brightness_of_the_picture_matters(mosaic: np.ndarray) -> None:
    plain = decode_raw(dng(mosaic, white=WHITE), "shot.dng")
    assert np.array_equal(plain, decode_raw(dng(mosaic, white=WHITE, neutral=(0.3, 1, 0.9)), "shot.dng"))
    one = mosaic.copy()
    one[:2, :2] = WHITE  # the brightest pixel, which LibRaw's own scaling may use
    assert np.array_equal(decode_raw(dng(one, white=WHITE), "shot.dng")[1:], plain[1:])


@pytest.mark.parametrize("area", [(0, 0, 37, 51), (3, 4, 31, 40), (2, 5, 34, 47), (1, 1, 36, 50)])
def test_dark_margins_are_left_out_and_colours_stay_in_place(
    mosaic: np.ndarray, area: tuple[int, int, int, int]
) -> None:
    """DNG counts the colour filter's pattern from the end of the margins. LibRaw omits a further row if it is odd."""
    codes = decode_raw(dng(mosaic, black=(512,), white=WHITE, area=area), "shot.dng")
    top, left = (edge + edge % 2 for edge in area[:2])
    assert codes.shape == ((area[2] - top) // 2, (area[3] - left) // 2, 3)
    light = ((mosaic.astype(np.float64) - 512) * (TOP / (WHITE - 512)))[top:, left:]
    pattern = np.roll(np.reshape(RGGB, (2, 2)), area[:2], (0, 1))
    for colour in range(3):
        assert np.abs(codes[..., colour] - mean_of(light, pattern, colour, 2, codes.shape[:2])).max() <= HALF


def mean_of(light: np.ndarray, pattern: np.ndarray, colour: int, cell: int, shape: tuple[int, int]) -> np.ndarray:
    """Return a colour's mean per cell, (height, width), of the light that a mosaic of `pattern` sees."""
    height, width = (side * cell for side in shape)
    period = len(pattern)
    here = np.tile(pattern == colour, (height // period + 1, width // period + 1))[:height, :width]
    cells = shape[0], cell, shape[1], cell
    total = np.where(here, light[:height, :width], 0).reshape(cells).sum(axis=(1, 3))
    return np.asarray(total / here.reshape(cells).sum(axis=(1, 3))).clip(0, TOP)


def test_other_mosaics(mosaic: np.ndarray) -> None:
    sites = mosaic.astype(np.float64) * (TOP / WHITE)
    bggr = decode_raw(dng(mosaic, white=WHITE, pattern=(2, 1, 1, 0)), "shot.dng")
    assert np.abs(bggr[..., 2] - sites[0:36:2, 0:50:2]).max() <= HALF
    xtrans = decode_raw(dng(mosaic, white=WHITE, pattern=XTRANS), "shot.dng")
    assert xtrans.shape == (12, 16, 3)
    for colour in range(3):
        expected = mean_of(sites, np.reshape(XTRANS, (6, 6)), colour, 3, (12, 16))
        assert np.abs(xtrans[..., colour] - expected).max() <= HALF
    grey = decode_raw(dng(mosaic, black=(512,), white=WHITE, pattern=()), "shot.dng")
    assert np.abs(grey - ((mosaic.astype(int) - 512) * TOP / (WHITE - 512)).clip(0)).max() <= HALF


def test_one_clipped_site_clips_its_colour(mosaic: np.ndarray) -> None:
    mosaic[0, 1] = WHITE  # one of the two greens
    mosaic[2, 2] = WHITE + 300
    codes = decode_raw(dng(mosaic, black=BLACK, white=WHITE), "shot.dng")
    assert codes[0, 0, 1] == TOP
    assert codes[1, 1, 0] == TOP
    clipped = Exposures().saturated([codes])
    assert clipped[0, 0]
    assert clipped[1, 1]


def cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


def levels_upside_down(_: bytes) -> bytes:
    return dng(np.full((32, 32), 100, np.uint16), black=(900,), white=800)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (cut, "LibRaw cannot read it"),
        (lambda content: content[:-2], "LibRaw cannot read it"),
        (lambda content: content[:40], "LibRaw cannot read it"),
        (lambda content: b"", "LibRaw cannot read it"),
        (lambda content: b"not a photograph " * 100, "LibRaw cannot read it"),
        (levels_upside_down, "a black level of 900 and a white level of 800"),
    ],
)
def test_damage_is_one_line(
    mosaic: np.ndarray,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    damage: Callable[[bytes], bytes],
    said: str,
) -> None:
    path = tmp_path / "a shot.nef"
    path.write_bytes(damage(dng(mosaic)))
    with pytest.raises(InputError, match=rf"a shot\.nef: ({said}).*; copy it from the camera again"):
        read_photograph(path)
    assert capfd.readouterr() == ("", "")


def test_what_libraw_only_complains_of_is_damage(
    mosaic: np.ndarray, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """For a corrupt compressed picture, LibRaw only prints the place and continues."""

    class Complaining(rawpy.RawPy):
        def unpack(self) -> None:
            os.write(2, b"unknown file: data corrupted at 1234\n")
            super().unpack()

    monkeypatch.setattr(rawpy, "RawPy", Complaining)
    with pytest.raises(InputError, match=r"shot\.dng: damaged or truncated \(data corrupted at 1234\); copy it"):
        decode_raw(dng(mosaic), "shot.dng")
    assert capfd.readouterr() == ("", "")


def test_random_damage_is_refused_or_read_but_never_crashes(mosaic: np.ndarray, rng: np.random.Generator) -> None:
    content, complaints = dng(mosaic, exposure_s=0.5), list[str]()
    header = len(content) - mosaic.nbytes
    for _ in range(300):
        damaged = bytearray(content)
        for at in rng.integers(0, header, 3):
            damaged[at] = rng.integers(256)
        try:
            assert decode_raw(bytes(damaged), "shot.dng").dtype == np.uint16
        except InputError as error:
            complaints.append(str(error))
    assert len(complaints) > 10
    assert not any("\n" in line for line in complaints)


def test_without_its_package_raw_says_what_to_install(
    mosaic: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rawpy", None)
    paths = [tmp_path / f"{i}.CR2" for i in range(2)]
    for path in paths:
        path.write_bytes(dng(mosaic))
    assert merge_exposures.main([*map(str, paths), "-o", str(tmp_path / "out.exr")]) == 2
    assert re.fullmatch(
        r"error: .*0\.CR2: camera RAW needs an extra package: pip install 'counterlight\[raw\]'\n",
        capsys.readouterr().err,
    )


# Brackets.


def write_bracket(folder: Path, light: np.ndarray, times_s: list[float]) -> list[str]:
    """Write DNGs of `light`, (height, width, 3). Light of 1 reaches the white level in one second."""
    paths = [folder / f"shot{i}.dng" for i in range(len(times_s))]
    for path, time_s in zip(paths, times_s, strict=True):
        codes = np.rint(light * time_s * (WHITE - 512) + 512).clip(0, WHITE)
        path.write_bytes(dng(mosaic_of(codes), black=(512,), white=WHITE, exposure_s=time_s))
    return [str(path) for path in paths]


def test_a_bracket_is_merged_as_linear_with_its_own_times(rng: np.random.Generator, tmp_path: Path) -> None:
    light = rng.uniform(0.02, 4, (30, 44, 3))
    paths = write_bracket(tmp_path, light, [0.125, 0.5, 2.0])
    command = [sys.executable, "-m", "counterlight", "merge-exposures", *paths, "-o", str(tmp_path / "out.exr")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "44x30, 3 pictures of 0.125 to 2 s, debevec, hat weights, response linear" in ended.stdout
    found = read_rgb(tmp_path / "out.exr")
    step = 1 / (WHITE - 512) / 0.125  # a code of the shortest exposure, which alone measures the brightest light
    assert np.abs(found - light).max() < 0.51 * step + 1e-3 * light.max()  # half a step, plus rounding to half-float


def test_a_curve_is_refused_for_what_is_linear(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = write_bracket(tmp_path, rng.uniform(0.1, 1, (16, 16, 3)), [0.25, 1.0])
    for curve in ("debevec", "srgb"):
        assert merge_exposures.main([*paths, "--response", curve, "-o", str(tmp_path / "out.exr")]) == 2
        assert re.fullmatch(rf"error: --response {curve}: .*shot0\.dng is camera RAW, .*\n", capsys.readouterr().err)
    assert not (tmp_path / "out.exr").exists()


def test_a_projectors_ramp_in_raw(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for level in range(0, 256, 15):
        light = np.full((16, 16, 3), 0.9 * (level / 255) ** 2.2 + 0.02)
        codes = np.rint(light * (WHITE - 512) + 512)
        (tmp_path / f"ramp_{level:03}.dng").write_bytes(dng(mosaic_of(codes), black=(512,), white=WHITE))
    out = tmp_path / "fitted" / "projector.toml"
    out.parent.mkdir()
    assert fit_projector_response.main([str(tmp_path), "-o", str(out)]) == 0
    codes = np.linspace(0, 1, 35)[::2]  # codes that were shown
    found = named_response(str(out)).to_linear(np.repeat(codes[:, None], 3, axis=1))
    assert np.abs(found - codes[:, None] ** 2.2).max() < 1e-3  # the table has 16 384 levels
    assert fit_projector_response.main([str(tmp_path), "--camera-response", "srgb", "-o", str(out)]) == 2
    assert "is camera RAW, which is linear" in capsys.readouterr().err


# Acquisition.


def photograph(exchange: Path, eye: SimulatedCamera, exposure_s: float) -> None:
    """Answer each request of the command with mosaics, named as cameras name files."""
    for path in sorted((exchange / "patterns").glob("*.png")):
        capture = exchange / "captures" / f"{path.stem}.DNG"
        if not capture.exists():
            (shot,) = eye.capture(int(path.stem), shown_by(path))
            codes = np.rint(shot / TOP * (WHITE - 512)) + 512
            capture.write_bytes(dng(mosaic_of(codes), black=(512,), white=WHITE, exposure_s=exposure_s))


def test_an_acquisition_of_raw_captures(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_blurred_room(tmp_path / "room", rng, CAMERA, PROJECTOR)
    eye = SimulatedCamera(simulated_rooms(tmp_path / "room")[0], CameraSettings())
    exchange, out = tmp_path / "exchange", tmp_path / "out"
    command = ["--camera", f"folder:{exchange}", "--projector", f"{PROJECTOR[1]}x{PROJECTOR[0]}", "-o", str(out)]
    command += ["--exposures", str(eye.exposures.times[0])]
    while acquire_transport.main(command) != 0:
        assert "waiting for" in capsys.readouterr().err
        photograph(exchange, eye, exposure_s=1 / 30)
    room = calibration.read(out)
    truth = read_transport(calibration.read(tmp_path / "room")).composition()
    found = read_transport(room).composition()
    assert np.corrcoef(truth.ravel(), found.ravel())[0, 1] > 0.99  # noise is below 1 %


def test_a_camera_that_exposes_otherwise_is_reported(tmp_path: Path) -> None:
    camera = FolderCamera(tmp_path, Exposures((0.1, 0.4)))
    camera._make_folders()
    picture, light = np.ones(PROJECTOR, np.bool_), np.full((16, 16, 3), 9000.0)
    for number, times_s in enumerate([(0.05, 0.2), (0.06, 0.2), (0.2, 0.05)]):
        for shot, time_s in enumerate(times_s):
            path = tmp_path / "captures" / f"{number:05}_{shot}.dng"
            path.write_bytes(dng(mosaic_of(light), exposure_s=time_s))
    # both files have half of the stated exposure; a common factor is harmless
    assert len(camera.capture(0, picture)) == 2
    assert len(camera.capture(1, picture)) == 2  # the exposures 1/20 s and 1/16 s are a third of a stop apart
    with pytest.raises(InputError, match=r"00002_0\.dng: exposed 4 times as much as --exposures says"):
        camera.capture(2, picture)
    curved = FolderCamera(tmp_path, Exposures((0.1, 0.4), Response("srgb")))
    with pytest.raises(InputError, match=r"--camera-response: .*00000_0\.dng is camera RAW, which is linear"):
        curved.capture(0, picture)


class Tether:
    """A tethered camera that delivers one file."""

    GP_CAPTURE_IMAGE, GP_FILE_TYPE_NORMAL = 0, 1
    model, folder = "Still", "/store"

    def __init__(self, name: str, content: bytes) -> None:
        self.name, self._content = name, content

    def get_abilities(self) -> "Tether":
        return self

    def capture(self, _: int) -> "Tether":
        return self

    def file_get(self, _folder: str, _name: str, _kind: int) -> "Tether":
        return self

    def get_data_and_size(self) -> bytes:
        return self._content

    def file_delete(self, _folder: str, _name: str) -> None:
        pass


def test_a_still_camera_may_give_raw(mosaic: np.ndarray) -> None:
    content = dng(mosaic, white=WHITE)
    tether = Tether("capt0000.dng", content)
    shot = TetheredDevice(tether, tether, Response("linear")).frame()
    assert np.array_equal(shot, decode_raw(content, "capt0000.dng"))
    with pytest.raises(InputError, match=r"Still: --camera-response: capt0000\.dng is camera RAW"):
        TetheredDevice(tether, tether, Response("srgb")).frame()
    tether = Tether("capt0000.heif", b"ftypheic" * 20)
    with pytest.raises(InputError, match=r"capt0000\.heif: neither PNG nor JPEG; .*; set the camera to RAW or JPEG"):
        TetheredDevice(tether, tether, Response("linear")).frame()
