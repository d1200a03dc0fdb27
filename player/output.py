"""Rendered frames into files: a picture, a numbered sequence, or a video. What fails leaves nothing half-written."""

import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
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
from player.errors import InputError
from player.files import replacing_file
from player.renderer import Renderer

PICTURES, VIDEOS = (".png", ".exr"), (".mp4", ".mov", ".mkv", ".webm")
NUMBER = re.compile(r"%0?\d*d")
# PyAV's log callback takes the GIL and can deadlock with a codec's threads; FFmpeg's own needs none.
av.logging.restore_default_callback()
av.logging.set_libav_level(av.logging.ERROR)
BT709 = 1  # FFmpeg's number for the primaries, the transfer and the matrix of ITU-R BT.709


class Output(Protocol):
    """Takes rendered frames one by one."""

    single: bool

    def write(self, renderer: Renderer) -> None: ...


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
        with _SequenceOutput(path) as sequence:
            yield sequence
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

    def write(self, renderer: Renderer) -> None:
        write_picture(self._path, renderer)


class _SequenceOutput:
    """Files numbered from 0, each whole; all removed if the run fails."""

    single = False

    def __init__(self, pattern: Path) -> None:
        self._pattern = pattern
        self._undo = ExitStack()
        self._count = 0

    def write(self, renderer: Renderer) -> None:
        number = NUMBER.sub(lambda match: match.group() % self._count, self._pattern.name)
        path = self._pattern.with_name(number)
        with replacing_file(path) as temporary:
            write_picture(temporary, renderer)
        self._undo.callback(path.unlink, missing_ok=True)
        self._count += 1

    def __enter__(self) -> "_SequenceOutput":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._undo.pop_all()
        self._undo.close()


class _VideoOutput:
    """H.264 in BT.709 limited range, or lossless FFV1 for .mkv."""

    single = False

    def __init__(self, path: Path, frames_per_second: float) -> None:
        self._container = av.open(str(path), "w")
        self._rate = Fraction(frames_per_second).limit_denominator(1001)
        self._lossless = path.suffix.lower() == ".mkv"
        self._stream: av.VideoStream | None = None

    def write(self, renderer: Renderer) -> None:
        picture = renderer.encoded()
        stream = self._stream or self._add_stream(picture)
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        if not self._lossless:
            # Without this, FFmpeg converts with BT.601 whatever the stream's tags say.
            frame = frame.reformat(
                format=stream.pix_fmt, dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
            )
        self._container.mux(stream.encode(frame))

    def _add_stream(self, picture: NDArray[np.uint8]) -> av.VideoStream:
        height, width = picture.shape[:2]
        codec = "ffv1" if self._lossless else "libvpx-vp9" if self._container.format.name == "webm" else "libx264"
        stream = self._container.add_stream(codec, rate=self._rate)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height = width, height
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
