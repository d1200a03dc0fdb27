"""player/video.py and its decoder process: known pictures through the whole pipe, and what happens when media break.

Pictures are numbered: luma is 16 + 8 n on the left half and 100 on the right one, so that order and flips show.
"""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import OpenEXR
import pytest

from player import exr
from player.errors import InputError
from player.video import Frame, MediaReader
from tests.ffmpeg_frames import Planes, ffmpeg_frame

TIMEOUT_S = 60.0  # patience only: nothing here is expected to take it
SHARED = Path(__file__).resolve().parents[1].parent / "shared" / "data"
VIDEOS = sorted((SHARED / "video").glob("*.mp4"))
_NOTES = {".json", ".upstream", ".pillow"}
HOSTILE = sorted(path for path in (SHARED / "hostile").glob("*/*") if path.suffix not in _NOTES)
RATE = 25
# The order of the bits in time: 0.04 s a frame is not a binary fraction, and containers round to their time base.
TIME_TOLERANCE_S = 1e-3  # Matroska counts in milliseconds


@pytest.fixture(autouse=True)
def _nothing_is_left() -> Iterator[None]:
    """No ring file and no decoder process survives a test."""
    folders = [Path("/dev/shm"), Path(tempfile.gettempdir())]
    before = {path for folder in folders for path in folder.glob("counterlight-*")}
    yield
    assert {path for folder in folders for path in folder.glob("counterlight-*")} <= before
    assert not _children()


def _children() -> list[int]:
    """Decoder processes of this process, as the kernel lists them (zombies too)."""
    return [int(pid) for task in Path("/proc/self/task").glob("*/children") for pid in task.read_text().split()]


def _numbered(n: int, height: int = 34, width: int = 46) -> Planes:
    """Picture n as yuv420p."""
    luma = np.full((height, width), 100, np.uint8)
    luma[:, : width // 2] = 16 + 8 * n % 200
    chroma = np.full((-(-height // 2), -(-width // 2)), 128, np.uint8)
    return luma, chroma, chroma


def _number(planes: Planes) -> int:
    return (int(planes[0][0, 0]) - 16) // 8


def _write(
    path: Path,
    pictures: list[Planes],
    *,
    pixel_format: str = "yuv420p",
    codec: str = "ffv1",
    first_pts: int = 0,
    tags: dict[str, int] | None = None,
    options: dict[str, str] | None = None,
    prepare: Callable[[Any], None] = lambda stream: None,
    container_options: dict[str, str] | None = None,
) -> Path:
    """Encode pictures without loss (ffv1, or libx264 with qp 0)."""
    with av.open(str(path), "w", options=container_options or {}) as container:
        stream: Any = container.add_stream(codec, rate=RATE, options=options or {})
        stream.height, stream.width = pictures[0][0].shape
        stream.pix_fmt = pixel_format
        for name, value in (tags or {}).items():
            setattr(stream.codec_context, name, value)
        prepare(stream)
        for i, picture in enumerate(pictures):
            frame = ffmpeg_frame(picture, pixel_format)
            frame.pts, frame.time_base = first_pts + i, Fraction(1, RATE)
            for name, value in (tags or {}).items():
                setattr(frame, name, value)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def _h264(path: Path, count: int = 40, **more: Any) -> Path:
    """A lossless clip with B-frames and a key frame every 10 pictures."""
    options = {"qp": "0", "g": "10", "bf": "2", "preset": "veryfast"}
    return _write(path, [_numbered(n % 25) for n in range(count)], codec="libx264", options=options, **more)


def _picture(path: Path, planes: Planes, pixel_format: str, codec: str) -> Path:
    """Encode one picture file."""
    context: Any = av.CodecContext.create(codec, "w")
    context.height, context.width = planes[0].shape[0], planes[0].shape[1]
    context.pix_fmt, context.time_base = pixel_format, Fraction(1, 25)
    frame = (
        av.VideoFrame.from_ndarray(planes[0], format=pixel_format)
        if len(planes) == 1
        else ffmpeg_frame(planes, pixel_format)
    )
    path.write_bytes(b"".join(bytes(packet) for packet in [*context.encode(frame), *context.encode(None)]))
    return path


def _copies(reader: MediaReader, limit: int = 10_000) -> list[tuple[float, Planes]]:
    """Times and copied planes of the frames to come."""
    found: list[tuple[float, Planes]] = []
    while len(found) < limit and (frame := reader.next_frame(TIMEOUT_S)) is not None:
        found.append((frame.time_s, tuple(plane.copy() for plane in frame.planes)))
        reader.release(frame)
    return found


def _read(path: Path, **options: Any) -> list[tuple[float, Planes]]:
    with MediaReader.open(path, **options) as reader:
        return _copies(reader)


def _until_error(reader: MediaReader) -> tuple[list[int], str]:
    """Numbers of the frames to come, and the error that ends them."""
    numbers: list[int] = []
    try:
        while (frame := reader.next_frame(TIMEOUT_S)) is not None:
            numbers.append(_number(frame.planes))
            reader.release(frame)
    except InputError as error:
        return numbers, str(error)
    raise AssertionError(f"{len(numbers)} frames and no error")


def _next(reader: MediaReader) -> Frame:
    frame = reader.next_frame(TIMEOUT_S)
    assert frame is not None
    return frame


def _equal(found: Planes, expected: Planes) -> None:
    for i, (a, b) in enumerate(zip(found, expected, strict=True)):
        np.testing.assert_array_equal(a, b, err_msg=f"plane {i}")


@pytest.mark.parametrize(
    ("pixel_format", "columns", "rows", "depth"),
    [
        ("yuv420p", 2, 2, 8),
        ("yuv422p", 2, 1, 8),
        ("yuv444p", 1, 1, 8),
        ("yuv420p10le", 2, 2, 10),
        ("yuv422p12le", 2, 1, 12),
        ("yuv444p16le", 1, 1, 16),
    ],
)
def test_yuv_planes_arrive_unchanged(
    pixel_format: str, columns: int, rows: int, depth: int, tmp_path: Path, rng: np.random.Generator
) -> None:
    height, width = 35, 47  # odd, so that the last chroma sample covers half a block
    shapes = [(height, width)] + 2 * [(-(-height // rows), -(-width // columns))]
    kind = np.uint8 if depth == 8 else np.uint16
    pictures = [tuple(rng.integers(0, 1 << depth, shape).astype(kind) for shape in shapes) for _ in range(3)]
    path = _write(tmp_path / "clip.mkv", pictures, pixel_format=pixel_format)
    with MediaReader.open(path) as reader:
        found = _copies(reader)
        described = reader.info.format
    assert (described.layout, described.depth) == ("yuv", depth)
    assert [(plane.height, plane.width) for plane in described.planes] == shapes
    assert len(found) == 3
    for (_, planes), picture in zip(found, pictures, strict=True):
        _equal(planes, picture)


@pytest.mark.parametrize(("pixel_format", "depth"), [("gbrp", 8), ("gbrp10le", 10)])
def test_rgb_planes_are_ordered_red_green_blue(
    pixel_format: str, depth: int, tmp_path: Path, rng: np.random.Generator
) -> None:
    kind = np.uint8 if depth == 8 else np.uint16
    red, green, blue = (rng.integers(0, 1 << depth, (21, 33)).astype(kind) for _ in range(3))
    codec = "utvideo" if depth == 8 else "ffv1"
    path = _write(tmp_path / "clip.avi", [(green, blue, red)] * 2, pixel_format=pixel_format, codec=codec)
    with MediaReader.open(path) as reader:
        (_, planes), _ = _copies(reader)
        assert (reader.info.format.layout, reader.info.format.depth) == ("rgb", depth)
        assert (reader.info.format.matrix, reader.info.format.full_range) == ("identity", True)
    _equal(planes, (red, green, blue))


@pytest.mark.parametrize(
    ("tags", "matrix", "full_range", "transfer"),
    [
        ({}, "bt709", False, "bt1886"),
        ({"colorspace": 1, "color_range": 2, "color_trc": 1}, "bt709", True, "bt1886"),
        ({"colorspace": 5, "color_range": 1, "color_trc": 13}, "bt601", False, "srgb"),
        ({"colorspace": 6, "color_range": 1, "color_trc": 4}, "bt601", False, "gamma22"),
        ({"colorspace": 9, "color_range": 1, "color_trc": 14}, "bt2020", False, "bt1886"),
    ],
)
def test_colour_tags(tags: dict[str, int], matrix: str, full_range: bool, transfer: str, tmp_path: Path) -> None:
    path = _write(tmp_path / "clip.mkv", [_numbered(3)] * 2, tags=tags)
    with MediaReader.open(path) as reader:
        described = reader.info.format
        (_, planes), _ = _copies(reader)
        assert reader.notices() == []
    assert (described.matrix, described.full_range, described.transfer) == (matrix, full_range, transfer)
    _equal(planes, _numbered(3))  # the range is described, never applied


def test_hdr_video_brings_a_notice(tmp_path: Path) -> None:
    path = _write(tmp_path / "clip.mkv", [_numbered(0)] * 2, tags={"color_trc": 16, "colorspace": 9})
    with MediaReader.open(path) as reader:
        (notice,) = reader.notices()
        assert reader.info.format.transfer == "bt1886"
        assert reader.notices() == []
    assert "PQ" in notice
    assert "tone mapping" in notice


@pytest.mark.parametrize("name", ["clip.mp4", "clip.mkv", "clip.ts", "clip.avi", "clip.h264"])
@pytest.mark.parametrize("first_pts", [0, 77])
def test_count_order_and_times(name: str, first_pts: int, tmp_path: Path) -> None:
    path = _h264(tmp_path / name, 20, first_pts=first_pts)
    with MediaReader.open(path) as reader:
        frames = [reader.next_frame(TIMEOUT_S) for _ in range(5)]
        for frame in frames:
            assert frame is not None
            reader.release(frame)
        found = _copies(reader)
        assert reader.ended
        assert reader.poll() is None
        assert not reader.info.still
    assert [frame.index for frame in frames if frame] == [0, 1, 2, 3, 4]
    times = [frame.time_s for frame in frames if frame] + [time_s for time_s, _ in found]
    np.testing.assert_allclose(times, np.arange(20) / RATE, atol=TIME_TOLERANCE_S, rtol=0)
    assert [_number(planes) for _, planes in found] == list(range(5, 20))


def test_rotation_is_counter_clockwise(tmp_path: Path) -> None:
    """FFmpeg's av_display_rotation_set takes the angle by which to rotate counter-clockwise; so does ours."""
    path = _h264(tmp_path / "clip.mp4", 3, prepare=lambda stream: stream.set_display_rotation(90))
    with MediaReader.open(path) as reader:
        assert reader.info.format.rotation == 90
        assert (reader.info.format.width, reader.info.format.height) == (46, 34)


@pytest.mark.parametrize(("orientation", "rotation"), [(1, 0), (3, 180), (6, 270), (8, 90)])
def test_exif_orientation(orientation: int, rotation: int, tmp_path: Path) -> None:
    """EXIF 6: the stored row 0 is the right-hand side, thus numpy.rot90(stored, 3) is upright; 8 is its opposite."""
    path = _jpeg(tmp_path / "p.jpg")
    tiff = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0" + bytes([orientation]) + b"\0\0\0\0\0\0"
    data, body = path.read_bytes(), b"Exif\0\0" + tiff
    path.write_bytes(data[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body + data[2:])
    with MediaReader.open(path) as reader:
        assert reader.info.format.rotation == rotation


def _jpeg(path: Path) -> Path:
    rng = np.random.default_rng(3)
    shapes = [(48, 64), (24, 32), (24, 32)]
    return _picture(path, tuple(rng.integers(0, 256, s).astype(np.uint8) for s in shapes), "yuvj420p", "mjpeg")


def test_jpeg_is_full_range_bt601_srgb(tmp_path: Path) -> None:
    path = _jpeg(tmp_path / "p.jpg")
    with av.open(str(path)) as container:
        frame = next(container.decode(video=0))
        expected = frame.to_ndarray()  # (rows of Y, then of Cb and Cr), without conversion
    ((_, planes),) = _read(path)
    np.testing.assert_array_equal(np.concatenate([plane.reshape(-1) for plane in planes]), expected.reshape(-1))
    with MediaReader.open(path, loop=True) as reader:
        described = reader.info.format
        assert reader.info.still
        assert reader.info.duration_s is None
        assert len(_copies(reader)) == 1  # a still does not loop
    assert (described.matrix, described.full_range, described.transfer) == ("bt601", True, "srgb")
    assert described.chroma_siting == "center"


def test_png_pictures_are_exact(tmp_path: Path, rng: np.random.Generator) -> None:
    rgb = rng.integers(0, 256, (31, 45, 3)).astype(np.uint8)
    gray = rng.integers(0, 65536, (31, 45)).astype(np.uint16)
    with MediaReader.open(_picture(tmp_path / "rgb.png", (rgb,), "rgb24", "png")) as reader:
        _equal(_next(reader).planes, tuple(rgb[..., i] for i in range(3)))
        assert reader.info.format.transfer == "srgb"
    with MediaReader.open(_picture(tmp_path / "gray.png", (gray,), "gray16be", "png")) as reader:
        _equal(_next(reader).planes, (gray, gray, gray))
        assert (reader.info.format.layout, reader.info.format.depth) == ("rgb", 16)


def test_alpha_is_composited_over_black(tmp_path: Path, rng: np.random.Generator) -> None:
    rgba = rng.integers(0, 256, (31, 45, 4)).astype(np.uint8)
    ((_, planes),) = _read(_picture(tmp_path / "p.png", (rgba,), "rgba", "png"))
    exact = rgba[..., :3].astype(float) * rgba[..., 3:] / 255
    for i, plane in enumerate(planes):
        np.testing.assert_allclose(plane, exact[..., i], atol=0.5, rtol=0)  # rounded to the nearest code


def test_sequence(tmp_path: Path, rng: np.random.Generator) -> None:
    pictures = [rng.integers(0, 256, (9, 15, 3)).astype(np.uint8) for _ in range(12)]
    for i, picture in enumerate(pictures):
        _picture(tmp_path / f"p{i + 97:03d}.png", (picture,), "rgb24", "png")  # the digits grow at 100
    found = _read(tmp_path / "p%03d.png", frames_per_second=50)
    np.testing.assert_allclose([t for t, _ in found], np.arange(12) / 50, atol=1e-9, rtol=0)  # float64 sums
    for (_, planes), picture in zip(found, pictures, strict=True):
        _equal(planes, tuple(picture[..., i] for i in range(3)))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "p3.png").unlink(), "number 3 is missing"),
        (lambda folder: (folder / "p3.png").write_bytes(b"no picture"), "frame 2"),
        (
            lambda folder: _picture(folder / "p3.png", (np.zeros((8, 8, 3), np.uint8),), "rgb24", "png"),
            "frame 2 is 8x8, expected 15x9",
        ),
        (lambda folder: [path.unlink() for path in folder.glob("*.png")], "no file matches"),
    ],
)
def test_spoiled_sequence(spoil: Callable[[Path], Any], message: str, tmp_path: Path) -> None:
    for i in range(1, 6):
        _picture(tmp_path / f"p{i}.png", (np.full((9, 15, 3), i, np.uint8),), "rgb24", "png")
    spoil(tmp_path)
    with pytest.raises(InputError, match=message):
        _read(tmp_path / "p%d.png")


def test_exr_is_radiance_as_it_is(tmp_path: Path, rng: np.random.Generator) -> None:
    radiance = (rng.normal(size=(7, 11, 3)) * 100).astype(np.float32)
    exr.write_rgb(tmp_path / "p.exr", radiance)
    with MediaReader.open(tmp_path / "p.exr") as reader:
        described = reader.info.format
        _equal(_next(reader).planes, tuple(radiance[..., i] for i in range(3)))
    assert (described.layout, described.depth, described.transfer) == ("radiance", 32, "linear")


def test_exr_sequence_seeks_and_loops(tmp_path: Path) -> None:
    for i in range(4):
        exr.write_rgb(tmp_path / f"p{i:02d}.exr", np.full((3, 5, 3), i, np.float32))
    with MediaReader.open(tmp_path / "p%02d.exr", loop=True, frames_per_second=10) as reader:
        values = [planes[0][0, 0] for _, planes in _copies(reader, 9)]
        reader.seek(0.25)
        frame = _next(reader)
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
    ((_, planes),) = _read(tmp_path / "p.exr")
    _equal(planes, (expected, expected, expected))


def test_exr_with_nan_names_the_place(tmp_path: Path) -> None:
    radiance = np.zeros((4, 6, 3), np.float32)
    radiance[2, 5, 1] = np.nan
    radiance[3, 0, 2] = np.inf
    exr.write_rgb(tmp_path / "p.exr", radiance)
    with pytest.raises(InputError, match=r"p\.exr: 2 values are NaN or infinite.*channel G at column 5, row 2"):
        _read(tmp_path / "p.exr")


def test_size_change_is_named(tmp_path: Path) -> None:
    first = _write(tmp_path / "a.ts", [_numbered(n) for n in range(6)], codec="mpeg2video")
    second = _write(tmp_path / "b.ts", [_numbered(n, 48, 64) for n in range(6)], codec="mpeg2video", first_pts=6)
    both = tmp_path / "both.ts"
    both.write_bytes(first.read_bytes() + second.read_bytes())
    with MediaReader.open(both) as reader:
        numbers, error = _until_error(reader)
        assert re.search(r"frame \d+ is 64x48, expected 46x34", error)
        with pytest.raises(InputError, match="re-encode"):  # the failure stays
            reader.next_frame(TIMEOUT_S)
    assert len(numbers) in (5, 6)  # FFmpeg's MPEG-2 decoder may drop the picture it holds back when the size changes


@pytest.mark.parametrize("name", ["clip.mp4", "clip.mkv"])
def test_truncated_video_gives_its_frames_then_an_error(name: str, tmp_path: Path) -> None:
    path = _h264(tmp_path / name, 100, container_options={"movflags": "faststart"} if name.endswith("mp4") else None)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])
    with MediaReader.open(path) as reader:
        numbers, error = _until_error(reader)
    assert re.search(r"ends early|cannot be decoded", error)
    assert numbers == [n % 25 for n in range(len(numbers))]
    assert 20 < len(numbers) < 90


@pytest.mark.parametrize("fraction", [0.3, 0.6, 0.95])
@pytest.mark.parametrize("kind", ["jpg", "png", "gif"])
def test_truncated_picture_is_refused(kind: str, fraction: float, tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / f"p.{kind}"
    if kind == "jpg":
        _jpeg(path)
    elif kind == "png":
        _picture(path, (rng.integers(0, 256, (31, 45, 3)).astype(np.uint8),), "rgb24", "png")
    else:
        _write(path, [(rng.integers(0, 256, (31, 45)).astype(np.uint8),)], pixel_format="gray", codec="gif")
    assert len(_read(path)) == 1
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * fraction)])
    with pytest.raises(InputError) as refusal:
        _read(path)
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize("name", ["clip.mp4", "clip.mkv", "clip.ts", "clip.h264"])
def test_seek_is_exact(name: str, tmp_path: Path) -> None:
    path = _h264(tmp_path / name, 40)
    with MediaReader.open(path) as reader:
        for target in (31, 0, 12, 39, 10, 11, 9):
            reader.seek((target + 0.5) / RATE)
            frame = _next(reader)
            assert _number(frame.planes) == target % 25
            assert frame.time_s == pytest.approx(target / RATE, abs=TIME_TOLERANCE_S)
            reader.release(frame)
        reader.seek(10.0)
        assert reader.next_frame(TIMEOUT_S) is None
        reader.seek(1.5)
        assert len(_copies(reader)) == 3  # frames 37 (shown at 1.5 s) to 39


@pytest.mark.parametrize("name", ["clip.mp4", "clip.mkv", "clip.ts", "clip.avi", "clip.h264"])
def test_loops_are_seamless(name: str, tmp_path: Path) -> None:
    path = _h264(tmp_path / name, 12)
    with MediaReader.open(path, loop=True) as reader:
        found = _copies(reader, 40)
        reader.seek(found[29][0] + 0.5 / RATE)  # a time of the third lap
        frame = _next(reader)
        assert _number(frame.planes) == 29 % 12
        assert frame.time_s == pytest.approx(found[29][0], abs=TIME_TOLERANCE_S)
    assert [_number(planes) for _, planes in found] == [n % 12 for n in range(40)]
    np.testing.assert_allclose(np.diff([t for t, _ in found]), 1 / RATE, atol=2 * TIME_TOLERANCE_S, rtol=0)


@pytest.mark.parametrize("cause", [signal.SIGKILL, signal.SIGSEGV, signal.SIGSTOP])
def test_killed_decoder_is_replaced_without_losing_a_frame(cause: signal.Signals, tmp_path: Path) -> None:
    path = _h264(tmp_path / "clip.mp4", 40)
    with MediaReader.open(path) as reader:
        before = _copies(reader, 15)
        held = _next(reader)
        os.kill(reader.decoder_pid, cause)
        found = [*before, (held.time_s, tuple(plane.copy() for plane in held.planes)), *_copies(reader)]
        reader.release(held)  # of a decoder that is gone
        (notice,) = reader.notices()
    assert [_number(planes) for _, planes in found] == [n % 25 for n in range(40)]
    np.testing.assert_allclose([t for t, _ in found], np.arange(40) / RATE, atol=TIME_TOLERANCE_S, rtol=0)
    assert "decoder" in notice
    assert "restarted" in notice


def test_decoder_killed_in_a_later_lap_keeps_the_time(tmp_path: Path) -> None:
    with MediaReader.open(_h264(tmp_path / "clip.mp4", 12), loop=True) as reader:
        found = _copies(reader, 30)
        os.kill(reader.decoder_pid, signal.SIGKILL)
        found += _copies(reader, 30)
    assert [_number(planes) for _, planes in found] == [n % 12 for n in range(60)]
    np.testing.assert_allclose([t for t, _ in found], np.arange(60) / RATE, atol=TIME_TOLERANCE_S, rtol=0)


def test_medium_that_always_kills_the_decoder_is_an_error(tmp_path: Path) -> None:
    """The file vanishes, so that no new decoder can open it."""
    path = _h264(tmp_path / "clip.mp4", 40)
    with MediaReader.open(path) as reader:
        path.unlink()
        os.kill(reader.decoder_pid, signal.SIGKILL)
        with pytest.raises(InputError, match="no such file"):
            _copies(reader)
        with pytest.raises(InputError, match="no such file"):
            reader.poll()


def test_decoder_ends_with_its_parent(tmp_path: Path) -> None:
    path = _h264(tmp_path / "clip.mp4", 40)
    code = f"""
import os, sys
from player.video import MediaReader
reader = MediaReader.open({str(path)!r}, loop=True)
print(reader.decoder_pid, flush=True)
os._exit(0)
"""
    root = str(Path(__file__).resolve().parents[1])
    ended = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    pid, deadline = int(ended.stdout), time.monotonic() + TIMEOUT_S
    while Path(f"/proc/{pid}").exists() and time.monotonic() < deadline:
        if Path(f"/proc/{pid}/stat").read_text().split()[2] == "Z":  # nobody reaps orphans in some containers
            break
        time.sleep(0.01)
    else:
        assert not Path(f"/proc/{pid}").exists()


def test_poll_never_waits_and_ends(tmp_path: Path) -> None:
    count = 0
    with MediaReader.open(_h264(tmp_path / "clip.mp4", 10)) as reader:
        deadline = time.monotonic() + TIMEOUT_S
        while not reader.ended and time.monotonic() < deadline:
            if (frame := reader.poll()) is not None:
                assert frame.index == count
                count += 1
                reader.release(frame)
            time.sleep(0.001)
        assert reader.ended
    assert count == 10


def test_frames_held_survive_close(tmp_path: Path) -> None:
    with MediaReader.open(_h264(tmp_path / "clip.mp4", 10)) as reader:
        frame = _next(reader)
    _equal(frame.planes, _numbered(0))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("absent.mp4", None, "no such file"),
        ("empty.mp4", b"", "empty"),
        ("text.mp4", b"Dear reader,\n" * 40, "cannot read it"),
        ("text.txt", b"Dear reader,\n" * 40, "no video or picture|cannot read it"),
        ("text.exr", b"Dear reader,\n" * 40, "not a readable OpenEXR"),
        ("frames-%04d.png", None, "no file matches"),
    ],
)
def test_what_is_no_medium_is_refused(name: str, content: bytes | None, message: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as refusal:
        MediaReader.open(path)
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_folder_and_audio_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"):
        MediaReader.open(tmp_path)
    path = tmp_path / "sound.wav"
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 8000), np.int16), format="s16", layout="mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
        container.mux(stream.encode(None))
    with pytest.raises(InputError, match="holds no video"):
        MediaReader.open(path)


if VIDEOS:

    @pytest.mark.parametrize("path", VIDEOS, ids=lambda path: path.stem)
    def test_shared_video_is_complete(path: Path) -> None:
        with av.open(str(path)) as container:
            stream = container.streams.best("video")
            assert stream is not None
            expected = sum(1 for _ in container.decode(stream))
        with MediaReader.open(path) as reader:
            assert len(_copies(reader)) == expected
            assert reader.info.frames == expected
            assert reader.notices() == []


if HOSTILE:

    @pytest.mark.parametrize("path", HOSTILE, ids=lambda path: path.name)
    def test_hostile_file_gives_frames_or_one_line(path: Path) -> None:
        try:
            assert _read(path)
        except InputError as error:
            line = str(error)
            assert str(path) in line
            assert "\n" not in line
            assert "decoder stopped" not in line  # refused, not crashed
