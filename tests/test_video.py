"""player/media/video.py and its decoder process: known pictures through the whole pipeline, in order and on time."""

import time
from pathlib import Path

import av
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.media.video import MediaReader
from tests.media import (
    RATE,
    SHARED,
    TIME_TOLERANCE_S,
    TIMEOUT_S,
    assert_equal,
    copies,
    next_frame,
    number,
    numbered,
    write_h264,
    write_video,
)

pytestmark = pytest.mark.usefixtures("nothing_is_left")
VIDEOS = sorted((SHARED / "video").glob("*.mp4"))


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
    path = write_video(tmp_path / "clip.mkv", pictures, pixel_format=pixel_format)
    with MediaReader.open(path) as reader:
        found = copies(reader)
        described = reader.info.format
    assert (described.layout, described.depth) == ("yuv", depth)
    assert [(plane.height, plane.width) for plane in described.planes] == shapes
    assert len(found) == 3
    for (_, planes), picture in zip(found, pictures, strict=True):
        assert_equal(planes, picture)


@pytest.mark.parametrize(("pixel_format", "depth"), [("gbrp", 8), ("gbrp10le", 10)])
def test_rgb_planes_are_ordered_red_green_blue(
    pixel_format: str, depth: int, tmp_path: Path, rng: np.random.Generator
) -> None:
    kind = np.uint8 if depth == 8 else np.uint16
    red, green, blue = (rng.integers(0, 1 << depth, (21, 33)).astype(kind) for _ in range(3))
    codec = "utvideo" if depth == 8 else "ffv1"
    path = write_video(tmp_path / "clip.avi", [(green, blue, red)] * 2, pixel_format=pixel_format, codec=codec)
    with MediaReader.open(path) as reader:
        (_, planes), _ = copies(reader)
        assert (reader.info.format.layout, reader.info.format.depth) == ("rgb", depth)
        assert (reader.info.format.matrix, reader.info.format.full_range) == ("identity", True)
    assert_equal(planes, (red, green, blue))


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
    path = write_video(tmp_path / "clip.mkv", [numbered(3)] * 2, tags=tags)
    with MediaReader.open(path) as reader:
        described = reader.info.format
        (_, planes), _ = copies(reader)
        assert reader.notices() == []
    assert (described.matrix, described.full_range, described.transfer) == (matrix, full_range, transfer)
    assert_equal(planes, numbered(3))  # the range is reported, never applied


def test_pq_that_names_no_peak_brings_a_notice(tmp_path: Path) -> None:
    path = write_video(tmp_path / "clip.mkv", [numbered(0)] * 2, tags={"color_trc": 16})
    with MediaReader.open(path) as reader:
        (notice,) = reader.notices()
        pixels = reader.info.format
        assert (pixels.transfer, pixels.matrix, pixels.primaries) == ("pq", "bt2020", "bt2020")
        assert reader.notices() == []
    assert "PQ" in notice
    assert "--hdr-peak" in notice


@pytest.mark.parametrize(("matrix", "name"), [(8, "YCgCo"), (14, "ICtCp")])
def test_a_matrix_that_is_not_known_is_refused(matrix: int, name: str, tmp_path: Path) -> None:
    path = write_video(tmp_path / "clip.mkv", [numbered(0)] * 2, tags={"colorspace": matrix})
    with pytest.raises(InputError, match=f"its {name} colour matrix is not supported; convert it to"):
        MediaReader.open(path)


@pytest.mark.parametrize("name", ["clip.mp4", "clip.mkv", "clip.ts", "clip.avi", "clip.h264"])
@pytest.mark.parametrize("first_pts", [0, 77])
def test_count_order_and_times(name: str, first_pts: int, tmp_path: Path) -> None:
    path = write_h264(tmp_path / name, 20, first_pts=first_pts)
    with MediaReader.open(path) as reader:
        frames = [reader.next_frame(TIMEOUT_S) for _ in range(5)]
        for frame in frames:
            assert frame is not None
            reader.release(frame)
        found = copies(reader)
        assert reader.ended
        assert reader.poll() is None
        assert not reader.info.still
    assert [frame.index for frame in frames if frame] == [0, 1, 2, 3, 4]
    times = [frame.time_s for frame in frames if frame] + [time_s for time_s, _ in found]
    np.testing.assert_allclose(times, np.arange(20) / RATE, atol=TIME_TOLERANCE_S, rtol=0)
    assert [number(planes) for _, planes in found] == list(range(5, 20))


def test_rotation_is_counter_clockwise(tmp_path: Path) -> None:
    """FFmpeg's av_display_rotation_set takes a counter-clockwise angle, and the player also turns counter-clockwise."""
    path = write_h264(tmp_path / "clip.mp4", 3, prepare=lambda stream: stream.set_display_rotation(90))
    with MediaReader.open(path) as reader:
        assert reader.info.format.rotation == 90
        assert (reader.info.format.width, reader.info.format.height) == (46, 34)


@pytest.mark.parametrize("name", ["clip.mp4", "clip.mkv", "clip.ts", "clip.h264"])
def test_seek_is_exact(name: str, tmp_path: Path) -> None:
    path = write_h264(tmp_path / name, 40)
    with MediaReader.open(path) as reader:
        for target in (31, 0, 12, 39, 10, 11, 9):
            reader.seek((target + 0.5) / RATE)
            frame = next_frame(reader)
            assert number(frame.planes) == target % 25
            assert frame.time_s == pytest.approx(target / RATE, abs=TIME_TOLERANCE_S)
            reader.release(frame)
        reader.seek(10.0)
        assert reader.next_frame(TIMEOUT_S) is None
        reader.seek(1.5)
        assert len(copies(reader)) == 3  # frames 37 (shown at 1.5 s) to 39


@pytest.mark.parametrize("name", ["clip.mp4", "clip.mkv", "clip.ts", "clip.avi", "clip.h264"])
def test_loops_are_seamless(name: str, tmp_path: Path) -> None:
    path = write_h264(tmp_path / name, 12)
    with MediaReader.open(path, loop=True) as reader:
        found = copies(reader, 40)
        reader.seek(found[29][0] + 0.5 / RATE)  # a time in the third lap
        frame = next_frame(reader)
        assert number(frame.planes) == 29 % 12
        assert frame.time_s == pytest.approx(found[29][0], abs=TIME_TOLERANCE_S)
    assert [number(planes) for _, planes in found] == [n % 12 for n in range(40)]
    np.testing.assert_allclose(np.diff([t for t, _ in found]), 1 / RATE, atol=2 * TIME_TOLERANCE_S, rtol=0)


def test_poll_never_waits_and_ends(tmp_path: Path) -> None:
    count = 0
    with MediaReader.open(write_h264(tmp_path / "clip.mp4", 10)) as reader:
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
    with MediaReader.open(write_h264(tmp_path / "clip.mp4", 10)) as reader:
        frame = next_frame(reader)
    assert_equal(frame.planes, numbered(0))


if VIDEOS:

    @pytest.mark.parametrize("path", VIDEOS, ids=lambda path: path.stem)
    def test_shared_video_is_complete(path: Path) -> None:
        with av.open(str(path)) as container:
            stream = container.streams.best("video")
            assert stream is not None
            expected = sum(1 for _ in container.decode(stream))
        with MediaReader.open(path) as reader:
            assert len(copies(reader)) == expected
            assert reader.info.frames == expected
            assert reader.notices() == []
