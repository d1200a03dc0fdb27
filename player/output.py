"""Rendered frames into files: a picture, a numbered sequence, or a video. What fails leaves nothing half-written."""

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Protocol

import av
import cv2
import numpy as np
from av.video.reformatter import ColorRange, Colorspace
from numpy.typing import NDArray

from player import exr
from player.decoding.ffmpeg_log import log_natively
from player.errors import InputError
from player.files import flush, refusals_named, replacing_file
from player.renderer import Renderer

PICTURES, VIDEOS = (".png", ".exr"), (".mp4", ".mov", ".mkv", ".webm")
NUMBER = re.compile(r"%0?\d*d")
CLOCK = Fraction(1, 90_000)  # ticks of a written video: each frame keeps the time that it had
BT709 = 1  # FFmpeg's number for the primaries, the transfer and the matrix of ITU-R BT.709

log_natively(av.logging.ERROR)


class Output(Protocol):
    """Takes rendered frames one by one."""

    single: bool

    def write(self, renderer: Renderer, time_s: float) -> None: ...


@contextmanager
def open_output(path: Path, frames_per_second: float) -> Iterator[Output]:
    """Open `path` for rendered frames; whatever was written is removed again if the block fails.

    `.png` holds the encoded view, `.exr` the linear one, `name%05d.png` numbers them, a video holds the encoded view.
    Raises InputError for a folder that is not there or a suffix that is not written.
    """
    suffix = path.suffix.lower()
    if suffix not in PICTURES + VIDEOS:
        raise InputError(
            f"{path}: cannot write {suffix or 'a file without suffix'}; use {', '.join(PICTURES + VIDEOS)}"
        )
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder; make it first")
    numbered = NUMBER.search(path.name) is not None
    if suffix in VIDEOS:
        if numbered:
            raise InputError(f"{path}: only .png and .exr are numbered; write name%05d.png or a plain {suffix}")
        with replacing_file(path) as temporary, _VideoOutput(temporary, frames_per_second) as video:
            yield video
    elif numbered:
        with refusals_named(path), tempfile.TemporaryDirectory(suffix=".partial", dir=path.parent) as stage:
            sequence = _SequenceOutput(path, Path(stage))
            yield sequence
            sequence.move()
    else:
        with replacing_file(path) as temporary:
            yield _PictureOutput(temporary)


def write_picture(path: Path, renderer: Renderer) -> None:
    """One rendered view: 8-bit PNG of the code values, or float32 EXR of the linear light."""
    if path.suffix.lower() == ".exr":
        exr.write_rgb(path, renderer.linear())
    elif not cv2.imwrite(str(path), np.ascontiguousarray(renderer.encoded()[..., ::-1])):
        raise OSError(f"OpenCV writes no {path.suffix} there")


class _PictureOutput:
    single = True

    def __init__(self, path: Path) -> None:
        self._path = path

    def write(self, renderer: Renderer, time_s: float) -> None:
        write_picture(self._path, renderer)


class _SequenceOutput:
    """Files numbered from 0, written beside their place and moved there together when all are whole."""

    single = False

    def __init__(self, pattern: Path, stage: Path) -> None:
        self._pattern, self._stage = pattern, stage
        self._names: list[str] = []

    def write(self, renderer: Renderer, time_s: float) -> None:
        name = NUMBER.sub(lambda match: match.group() % len(self._names), self._pattern.name)
        write_picture(self._stage / name, renderer)
        self._names.append(name)

    def move(self) -> None:
        for name in self._names:
            flush(self._stage / name)
            (self._stage / name).replace(self._pattern.with_name(name))


class _VideoOutput:
    """H.264 in BT.709 limited range, or lossless FFV1 for .mkv."""

    single = False

    def __init__(self, path: Path, frames_per_second: float) -> None:
        self._container = av.open(f"file:{path}", "w")  # else a colon in the name would be taken for a protocol
        self._rate = Fraction(frames_per_second).limit_denominator(1001)
        self._lossless = path.suffix.lower() == ".mkv"
        self._stream: av.VideoStream | None = None
        self._first_s: float | None = None

    def write(self, renderer: Renderer, time_s: float) -> None:
        picture = renderer.encoded()
        stream = self._stream or self._add_stream(picture)
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        if not self._lossless:
            # Without this, FFmpeg converts with BT.601 whatever the stream's tags say.
            frame = frame.reformat(
                format=stream.pix_fmt, dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
            )
        if self._first_s is None:
            self._first_s = time_s
        frame.time_base = CLOCK
        frame.pts = round((time_s - self._first_s) / CLOCK)
        self._container.mux(stream.encode(frame))

    def _add_stream(self, picture: NDArray[np.uint8]) -> av.VideoStream:
        height, width = picture.shape[:2]
        codec = "ffv1" if self._lossless else "libvpx-vp9" if self._container.format.name == "webm" else "libx264"
        stream = self._container.add_stream(codec, rate=self._rate)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height = width, height
        stream.codec_context.time_base = CLOCK
        if self._lossless:
            stream.pix_fmt = "bgr0"
        else:
            even = width % 2 == 0 and height % 2 == 0
            stream.pix_fmt = "yuv420p" if even else "yuv444p"
            stream.options = {"crf": "14"}
            context = stream.codec_context
            context.colorspace = context.color_primaries = context.color_trc = BT709
            context.color_range = int(ColorRange.MPEG)
        self._stream = stream
        return stream

    def __enter__(self) -> "_VideoOutput":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None and self._stream is not None:
            self._container.mux(self._stream.encode(None))
        self._container.close()
