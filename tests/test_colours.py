"""Decoded colours of real clips against FFmpeg's conversion, and against the standards' numbers."""

from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from av.video.reformatter import ColorRange, Colorspace

from counterlight.media.video import Frame, MediaReader
from counterlight.pipeline.placement import place, shown_shape
from counterlight.pipeline.signal import signal_of
from counterlight.response import transfer_table
from counterlight.tools.shipped import CLIP
from tests.oracles import formulas
from tests.rooms import yuv_frame

ROOT = Path(__file__).resolve().parents[1]
CLIPS = [CLIP]
CLIPS += sorted((ROOT.parent / "shared" / "data" / "video").glob("*.mp4"))
SPACES = {"bt601": Colorspace.ITU601, "bt709": Colorspace.ITU709}
CODES = transfer_table("srgb")  # any monotone curve: codes are converted and converted back


def code_values(frame: Frame) -> np.ndarray:
    """R'G'B' code values of a frame, 0..255, through the CPU function (tests/gl compares the shader with it)."""
    signal = signal_of(frame.format)
    assert signal is not None
    linear = formulas.planes_to_linear(frame.planes, frame.format, replace(signal, transfer=CODES))
    return 255 * np.interp(linear, CODES, np.linspace(0, 1, CODES.size))


@pytest.mark.parametrize("path", CLIPS, ids=lambda path: path.stem)
def test_colours_agree_with_ffmpeg(path: Path) -> None:
    with MediaReader.open(path) as reader:
        frame = reader.next_frame(60)
        assert frame is not None
        ours, pixels = code_values(frame), frame.format
        reader.release(frame)
    with av.open(str(path)) as container:
        stream = container.streams.best("video")
        assert stream is not None
        decoded = next(container.decode(stream))
        theirs = decoded.reformat(
            format="rgb24",
            src_colorspace=SPACES[pixels.matrix],
            src_color_range=ColorRange.JPEG if pixels.full_range else ColorRange.MPEG,
            dst_color_range=ColorRange.JPEG,
        )
        expected = np.rot90(theirs.to_ndarray().astype(float), pixels.rotation // 90)
    assert ours.shape == expected.shape == (*shown_shape(pixels), 3)
    # swscale takes the nearest chroma sample and rounds low by up to 1.5 codes; a wrong matrix or range is off by 5 to
    # 20.
    assert np.abs(ours - expected).mean() < 3
    assert np.abs((ours - expected).mean(axis=(0, 1))).max() < 2


def test_the_clips_cover_both_ranges_and_a_rotation() -> None:
    """Check that the clips cover the cases of the test above (only if the shared clips exist)."""
    if len(CLIPS) == 1:
        return
    formats = []
    for path in CLIPS:
        with MediaReader.open(path) as reader:
            formats.append(reader.info.format)
    assert {pixels.full_range for pixels in formats} == {False, True}
    assert {pixels.rotation for pixels in formats} > {0}
    assert {pixels.depth for pixels in formats} == {8, 10}


@pytest.mark.parametrize(("depth", "unit"), [(8, 1), (10, 4), (12, 16)])
def test_limited_range_ends_at_the_standards_codes(rng: np.random.Generator, depth: int, unit: int) -> None:
    for luma, expected in ((16 * unit, 0.0), (235 * unit, 255.0), (0, 0.0), (255 * unit, 255.0)):
        frame = yuv_frame(rng, (4, 6), depth=depth, matrix="bt601")
        for plane, value in zip(frame.planes, (luma, 128 * unit, 128 * unit), strict=True):
            plane[...] = value
        np.testing.assert_allclose(code_values(frame), expected, atol=1e-2)  # interpolation in the table, twice


@pytest.mark.parametrize(
    ("matrix", "codes"),
    [("bt601", (81, 90, 240)), ("bt709", (63, 102, 240)), ("bt2020", (74, 97, 240))],
)
def test_saturated_red_in_each_standard(rng: np.random.Generator, matrix: str, codes: tuple[int, int, int]) -> None:
    """Y'CbCr of pure red, rounded to 8 bits, from the standards' equations."""
    frame = yuv_frame(rng, (4, 6), matrix=matrix)
    for plane, value in zip(frame.planes, codes, strict=True):
        plane[...] = value
    np.testing.assert_allclose(code_values(frame)[0, 0], [255, 0, 0], atol=2)  # three roundings to 8 bits


@pytest.mark.parametrize(
    ("shape", "aspect", "rotation", "target", "expected"),
    [
        ((720, 1280), 1.0, 0, (480, 640), (0, 60, 640, 360)),
        ((1280, 720), 1.0, 0, (480, 640), (185, 0, 270, 480)),
        ((720, 1280), 1.0, 90, (480, 640), (185, 0, 270, 480)),
        ((576, 720), 16 / 15, 0, (600, 800), (0, 0, 800, 600)),
        ((3, 1000), 1.0, 0, (10, 10), (0, 4, 10, 1)),
    ],
)
def test_pictures_are_fitted_upright_and_keep_their_aspect(
    rng: np.random.Generator,
    shape: tuple[int, int],
    aspect: float,
    rotation: int,
    target: tuple[int, int],
    expected: tuple[int, int, int, int],
) -> None:
    spot = place(yuv_frame(rng, shape, pixel_aspect=aspect, rotation=rotation).format, target)
    assert (spot.left, spot.top, spot.width, spot.height) == expected
