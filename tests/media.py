"""Media with known pictures for tests of player/media/video.py, and functions that read them.

Pictures are numbered: luma is 16 + 8 n on the left half and 100 on the right half, so that order and flips show.
"""

import os
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from counterlight.errors import InputError
from counterlight.media.video import Frame, MediaReader
from tests.ffmpeg_frames import Planes, ffmpeg_frame

SHARED = (Path(__file__).parents[2] / "shared" / "data").resolve()  # errors also name resolved paths
TIMEOUT_S = 60.0  # never reached in a passing test
RATE = 25
# The bits differ in time: 0.04 s per frame is not a binary fraction, and containers round to their time base.
TIME_TOLERANCE_S = 1e-3  # Matroska states times in milliseconds


def numbered(n: int, height: int = 34, width: int = 46) -> Planes:
    """Returns picture n as yuv420p."""
    luma = np.full((height, width), 100, np.uint8)
    luma[:, : width // 2] = 16 + 8 * n % 200
    chroma = np.full((-(-height // 2), -(-width // 2)), 128, np.uint8)
    return luma, chroma, chroma


def number(planes: Planes) -> int:
    return (int(planes[0][0, 0]) - 16) // 8


def write_video(
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
    """Encode pictures losslessly (ffv1, or libx264 with qp 0)."""
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


def write_h264(path: Path, count: int = 40, **more: Any) -> Path:
    """Write a lossless clip with B-frames and a key frame every 10 pictures."""
    options = {"qp": "0", "g": "10", "bf": "2", "preset": "veryfast"}
    return write_video(path, [numbered(n % 25) for n in range(count)], codec="libx264", options=options, **more)


def damage(path: Path, first: int, last: int) -> None:
    """Damage the middle third of the packets of pictures `first` to `last`, in decoding order."""
    with av.open(str(path)) as container:
        packets = [(packet.pos, packet.size) for packet in container.demux(video=0) if packet.size]
    data = bytearray(path.read_bytes())
    for position, size in packets[first : last + 1]:
        assert position is not None
        for index in range(position + size // 3, position + 2 * size // 3 + 1):
            data[index] ^= 0x5A
    path.write_bytes(data)


def write_picture(path: Path, planes: Planes, pixel_format: str, codec: str) -> Path:
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


def write_jpeg(path: Path) -> Path:
    rng = np.random.default_rng(3)
    shapes = [(48, 64), (24, 32), (24, 32)]
    return write_picture(path, tuple(rng.integers(0, 256, s).astype(np.uint8) for s in shapes), "yuvj420p", "mjpeg")


def copies(reader: MediaReader, limit: int = 10_000) -> list[tuple[float, Planes]]:
    """Times and copied planes of the remaining frames."""
    found: list[tuple[float, Planes]] = []
    while len(found) < limit and (frame := reader.next_frame(TIMEOUT_S)) is not None:
        found.append((frame.time_s, tuple(plane.copy() for plane in frame.planes)))
        reader.release(frame)
    return found


def read(path: Path, **options: Any) -> list[tuple[float, Planes]]:
    with MediaReader.open(path, **options) as reader:
        return copies(reader)


def next_frame(reader: MediaReader) -> Frame:
    frame = reader.next_frame(TIMEOUT_S)
    assert frame is not None
    return frame


def until_error(reader: MediaReader) -> tuple[list[int], str]:
    """Numbers of the remaining frames, and the error that ends them."""
    numbers: list[int] = []
    try:
        while (frame := reader.next_frame(TIMEOUT_S)) is not None:
            numbers.append(number(frame.planes))
            reader.release(frame)
    except InputError as error:
        return numbers, str(error)
    raise AssertionError(f"{len(numbers)} frames and no error")


def assert_equal(found: Planes, expected: Planes) -> None:
    for i, (a, b) in enumerate(zip(found, expected, strict=True)):
        np.testing.assert_array_equal(a, b, err_msg=f"plane {i}")


def rings(pid: int | str = "self") -> list[Path]:
    """Descriptors of the memory through which decoders pass frames."""
    links = Path(f"/proc/{pid}/fd").iterdir()
    return [link for link in links if link.is_symlink() and "counterlight-ring" in os.readlink(link)]
