"""player/media/decoding/pixels.py: FFmpeg frames of known code values, format by format, in odd sizes."""

from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.media.decoding import pixels
from tests.ffmpeg_frames import Planes, ffmpeg_frame


def _equal(found: Planes, expected: Planes) -> None:
    for i, (a, b) in enumerate(zip(found, expected, strict=True)):
        np.testing.assert_array_equal(a, b, err_msg=f"plane {i}")


@pytest.mark.parametrize(
    ("pixel_format", "columns", "rows", "shift"),  # shift: p010 stores its ten bits in the upper bits
    [("nv12", 2, 2, 0), ("nv16", 2, 1, 0), ("nv24", 1, 1, 0), ("p010le", 2, 2, 6), ("p210le", 2, 1, 6)],
)
@pytest.mark.parametrize("color_range", [0, 1, 2])
def test_semi_planar_yuv_is_only_repacked(
    pixel_format: str, columns: int, rows: int, shift: int, color_range: int, rng: np.random.Generator
) -> None:
    kind, top = (np.uint16, 1024) if shift else (np.uint8, 256)
    luma = rng.integers(0, top, (31, 47))
    cb, cr = (rng.integers(0, top, (-(-31 // rows), -(-47 // columns))) for _ in range(2))
    interleaved = np.stack([cb, cr], axis=-1).reshape(cb.shape[0], -1)
    frame = ffmpeg_frame(((luma << shift).astype(kind), (interleaved << shift).astype(kind)), pixel_format)
    frame.color_range = color_range
    samples = pixels.unpack(frame, picture=False)
    _equal(samples.planes, (luma, cb, cr))
    assert samples.full_range == (color_range == 2)


@pytest.mark.parametrize("order", ["uyvy422", "yuyv422", "yvyu422", "y210le"])
def test_packed_422_is_unpacked(order: str, rng: np.random.Generator) -> None:
    letters = order[:4] if order.endswith("422") else "yuyv"
    depth = 8 if order.endswith("422") else 10
    packed = rng.integers(0, 1 << depth, (5, 4, 4))  # the axes are rows, pairs of pixels, samples
    stored = packed.astype(np.uint8) if depth == 8 else (packed << 6).astype(np.uint16)
    samples = pixels.unpack(_frame_of_rows(stored, order, width=7), picture=False)
    luma = packed[..., letters.index("y") :: 2].reshape(5, -1)[:, :7]
    _equal(samples.planes, (luma, packed[..., letters.index("u")], packed[..., letters.index("v")]))
    assert samples.depth == depth


@pytest.mark.parametrize(("order", "rows", "columns"), [("yuv411p", 1, 2), ("yuv410p", 2, 2), ("yuv440p", 2, 1)])
def test_coarse_chroma_is_repeated(order: str, rows: int, columns: int, rng: np.random.Generator) -> None:
    frame = av.VideoFrame(16, 8, order)
    luma, *chroma = (rng.integers(0, 256, (plane.height, plane.width)).astype(np.uint8) for plane in frame.planes)
    samples = pixels.unpack(ffmpeg_frame((luma, *chroma), order), picture=False)
    _equal(samples.planes, (luma, *(np.kron(plane, np.ones((rows, columns), np.uint8)) for plane in chroma)))


@pytest.mark.parametrize("name", ["pal8", "monow", "monob"])
def test_palette_and_bits(name: str, rng: np.random.Generator) -> None:
    if name == "pal8":
        codes, colours = rng.integers(0, 256, (5, 7)).astype(np.uint8), rng.integers(0, 256, (256, 4)).astype(np.uint8)
        frame = _frame_of_rows(codes, name)
        frame.planes[1].update(colours.tobytes())  # little endian ARGB: B, G, R, A
        expected = tuple(colours[codes][..., i] for i in (2, 1, 0))
    else:
        bits = rng.integers(0, 2, (5, 16)).astype(np.uint8)
        frame = _frame_of_rows(np.packbits(bits, axis=1), name, width=13)
        expected = 3 * ((bits[:, :13] ^ (name == "monow")) * np.uint8(255),)
    _equal(pixels.unpack(frame, picture=True).planes, expected)


def test_mirrored_pictures_are_flipped(rng: np.random.Generator) -> None:
    gray = rng.integers(0, 256, (5, 7)).astype(np.uint8)
    frame = ffmpeg_frame((gray,), "gray")
    out = tuple(np.empty_like(gray) for _ in range(3))
    pixels.store(pixels.unpack(frame, picture=True), out, flip_rows=True)
    _equal(out, 3 * (gray[::-1],))


def test_unknown_pixel_format_is_refused() -> None:
    with pytest.raises(InputError, match="xyz12le"):
        pixels.unpack(av.VideoFrame(16, 16, "xyz12le"), picture=False)


@pytest.mark.parametrize(
    "order", ["rgb24", "bgr24", "rgba", "bgra", "argb", "abgr", "rgb0", "0bgr", "rgb48be", "bgr48le"]
)
def test_packed_rgb_is_unpacked_by_its_letters(order: str, rng: np.random.Generator) -> None:
    letters = order[:4] if set(order) & set("a0") else order[:3]
    kind = ">u2" if order.endswith("be") else "<u2" if order.endswith("le") else "u1"
    packed = rng.integers(0, 256, (5, 7, len(letters))).astype(kind)
    samples = pixels.unpack(_frame_of_rows(packed, order), picture=True)
    _equal(samples.planes, tuple(packed[..., letters.index(letter)] for letter in "rgb"))
    assert (samples.alpha is None) == ("a" not in letters)


def _frame_of_rows(packed: NDArray[Any], pixel_format: str, width: int | None = None) -> av.VideoFrame:
    """Return a frame of one packed plane, (rows, columns, channels)."""
    frame = av.VideoFrame(width or packed.shape[1], packed.shape[0], pixel_format)
    rows = np.zeros((packed.shape[0], frame.planes[0].line_size), np.uint8)
    stored = np.ascontiguousarray(packed).view(np.uint8).reshape(packed.shape[0], -1)
    rows[:, : stored.shape[1]] = stored
    frame.planes[0].update(rows.tobytes())
    return frame


@pytest.mark.parametrize(("color_range", "picture", "layout"), [(2, False, "rgb"), (0, True, "rgb"), (0, False, "yuv")])
def test_gray_is_rgb_when_full_range_and_luma_otherwise(
    color_range: int, picture: bool, layout: str, rng: np.random.Generator
) -> None:
    gray = rng.integers(0, 256, (5, 7)).astype(np.uint8)
    frame = ffmpeg_frame((gray,), "gray")
    frame.color_range = color_range
    samples = pixels.unpack(frame, picture=picture)
    assert samples.layout == layout
    neutral = np.full((1, 1), 128, np.uint8)
    _equal(samples.planes, (gray, gray, gray) if layout == "rgb" else (gray, neutral, neutral))


def test_transparent_yuv_becomes_black_without_colour() -> None:
    planes = tuple(np.full(shape, 200, np.uint8) for shape in [(4, 6), (2, 3), (2, 3)])
    samples = pixels.unpack(ffmpeg_frame((*planes, np.zeros((4, 6), np.uint8)), "yuva420p"), picture=False)
    out = tuple(np.empty_like(plane) for plane in planes)
    pixels.store(samples, out, flip_rows=False)
    assert [int(plane.min()) for plane in out] == [16, 128, 128]
    assert [int(plane.max()) for plane in out] == [16, 128, 128]
