"""Pictures and numbered sequences through player/media/video.py: JPEG, PNG and OpenEXR, exact."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import OpenEXR
import pytest

from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.media.video import MediaReader
from tests.media import assert_equal, copies, next_frame, read, write_jpeg, write_picture

pytestmark = pytest.mark.usefixtures("nothing_is_left")


def test_jpeg_is_full_range_bt601_srgb(tmp_path: Path) -> None:
    path = write_jpeg(tmp_path / "p.jpg")
    with av.open(str(path)) as container:
        frame = next(container.decode(video=0))
        expected = frame.to_ndarray()  # (rows of Y, then of Cb and Cr), without conversion
    ((_, planes),) = read(path)
    np.testing.assert_array_equal(np.concatenate([plane.reshape(-1) for plane in planes]), expected.reshape(-1))
    with MediaReader.open(path, loop=True) as reader:
        described = reader.info.format
        assert reader.info.still
        assert reader.info.duration_s is None
        assert len(copies(reader)) == 1  # a still does not loop
    assert (described.matrix, described.full_range, described.transfer) == ("bt601", True, "srgb")
    assert described.chroma_siting == "center"


@pytest.mark.parametrize(("orientation", "rotation"), [(1, 0), (3, 180), (6, 270), (8, 90)])
def test_exif_orientation(orientation: int, rotation: int, tmp_path: Path) -> None:
    """EXIF 6: stored row 0 is the right-hand side, so numpy.rot90(stored, 3) is upright. 8 is the opposite."""
    path = write_jpeg(tmp_path / "p.jpg")
    tiff = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0" + bytes([orientation]) + b"\0\0\0\0\0\0"
    data, body = path.read_bytes(), b"Exif\0\0" + tiff
    path.write_bytes(data[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body + data[2:])
    with MediaReader.open(path) as reader:
        assert reader.info.format.rotation == rotation


def test_png_pictures_are_exact(tmp_path: Path, rng: np.random.Generator) -> None:
    rgb = rng.integers(0, 256, (31, 45, 3)).astype(np.uint8)
    gray = rng.integers(0, 65536, (31, 45)).astype(np.uint16)
    with MediaReader.open(write_picture(tmp_path / "rgb.png", (rgb,), "rgb24", "png")) as reader:
        assert_equal(next_frame(reader).planes, tuple(rgb[..., i] for i in range(3)))
        assert reader.info.format.transfer == "srgb"
    with MediaReader.open(write_picture(tmp_path / "gray.png", (gray,), "gray16be", "png")) as reader:
        assert_equal(next_frame(reader).planes, (gray, gray, gray))
        assert (reader.info.format.layout, reader.info.format.depth) == ("rgb", 16)


def test_alpha_is_composited_over_black(tmp_path: Path, rng: np.random.Generator) -> None:
    rgba = rng.integers(0, 256, (31, 45, 4)).astype(np.uint8)
    ((_, planes),) = read(write_picture(tmp_path / "p.png", (rgba,), "rgba", "png"))
    exact = rgba[..., :3].astype(float) * rgba[..., 3:] / 255
    for i, plane in enumerate(planes):
        np.testing.assert_allclose(plane, exact[..., i], atol=0.5, rtol=0)  # rounded to the nearest code


def test_sequence(tmp_path: Path, rng: np.random.Generator) -> None:
    pictures = [rng.integers(0, 256, (9, 15, 3)).astype(np.uint8) for _ in range(12)]
    for i, picture in enumerate(pictures):
        write_picture(tmp_path / f"p{i + 97:03d}.png", (picture,), "rgb24", "png")  # numbers gain a digit at 100
    found = read(tmp_path / "p%03d.png", frames_per_second=50)
    np.testing.assert_allclose([t for t, _ in found], np.arange(12) / 50, atol=1e-9, rtol=0)  # float64 sums
    for (_, planes), picture in zip(found, pictures, strict=True):
        assert_equal(planes, tuple(picture[..., i] for i in range(3)))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "p3.png").unlink(), "number 3 is missing"),
        (lambda folder: (folder / "p3.png").write_bytes(b"no picture"), "frame 2"),
        (
            lambda folder: write_picture(folder / "p3.png", (np.zeros((8, 8, 3), np.uint8),), "rgb24", "png"),
            "frame 2 is 8x8, expected 15x9",
        ),
        (lambda folder: [path.unlink() for path in folder.glob("*.png")], "no file matches"),
    ],
)
def test_spoiled_sequence(spoil: Callable[[Path], Any], message: str, tmp_path: Path) -> None:
    for i in range(1, 6):
        write_picture(tmp_path / f"p{i}.png", (np.full((9, 15, 3), i, np.uint8),), "rgb24", "png")
    spoil(tmp_path)
    with pytest.raises(InputError, match=message):
        read(tmp_path / "p%d.png")


def test_exr_is_radiance_as_it_is(tmp_path: Path, rng: np.random.Generator) -> None:
    radiance = (rng.normal(size=(7, 11, 3)) * 100).astype(np.float32)
    exr.write_rgb(tmp_path / "p.exr", radiance)
    with MediaReader.open(tmp_path / "p.exr") as reader:
        described = reader.info.format
        assert_equal(next_frame(reader).planes, tuple(radiance[..., i] for i in range(3)))
    assert (described.layout, described.depth, described.transfer) == ("radiance", 32, "linear")


def test_exr_sequence_seeks_and_loops(tmp_path: Path) -> None:
    for i in range(4):
        exr.write_rgb(tmp_path / f"p{i:02d}.exr", np.full((3, 5, 3), i, np.float32))
    with MediaReader.open(tmp_path / "p%02d.exr", loop=True, frames_per_second=10) as reader:
        values = [planes[0][0, 0] for _, planes in copies(reader, 9)]
        reader.seek(0.25)
        frame = next_frame(reader)
        assert (float(frame.planes[0][0, 0]), frame.index) == (2.0, 2)
    assert values == [0, 1, 2, 3, 0, 1, 2, 3, 0]


def test_exr_data_window_is_placed_in_the_display_window(tmp_path: Path) -> None:
    inner = np.arange(6, dtype=np.float32).reshape(2, 3) + 1
    corners = {"dataWindow": ([1, 2], [3, 3]), "displayWindow": ([0, 0], [5, 4])}
    windows = {name: tuple(np.array(corner, np.int32) for corner in pair) for name, pair in corners.items()}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | windows
    with OpenEXR.File(header, {"Y": inner}) as file:
        file.write(str(tmp_path / "p.exr"))
    expected = np.zeros((5, 6), np.float32)
    expected[2:4, 1:4] = inner
    ((_, planes),) = read(tmp_path / "p.exr")
    assert_equal(planes, (expected, expected, expected))


def test_exr_with_nan_names_the_place(tmp_path: Path) -> None:
    radiance = np.zeros((4, 6, 3), np.float32)
    radiance[2, 5, 1] = np.nan
    radiance[3, 0, 2] = np.inf
    exr.write_rgb(tmp_path / "p.exr", radiance)
    with pytest.raises(InputError, match=r"p\.exr: 2 values are NaN or infinite.*channel G at column 5, row 2"):
        read(tmp_path / "p.exr")
