"""Writes rendered frames into files: a picture, a numbered sequence, or a video. A failure leaves no partial file."""

import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from math import isnan
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, runtime_checkable

import av
import numpy as np
from av.video.reformatter import ColorRange, Colorspace
from numpy.typing import NDArray

from counterlight.command import tell
from counterlight.errors import InputError
from counterlight.files import exr
from counterlight.files.picture_files import read_picture, write_png
from counterlight.media.decoding.opening import log_natively
from counterlight.media.sound_track import SoundTrack
from counterlight.media.video import MediaReader
from counterlight.writing.numbered import is_numbered, name_of
from counterlight.writing.outputs import check_file, check_sequence
from counterlight.writing.replacing import replacing_file, replacing_sequence

PICTURES, VIDEOS = (".png", ".exr"), (".mp4", ".mov", ".mkv", ".webm")
CLOCK = Fraction(1, 90_000)  # time unit of a written video; each frame keeps its time
USUAL_CRF = 14
PART_TIMEOUT_S = 120.0
BT709 = 1  # FFmpeg's number for the primaries, the transfer and the matrix of ITU-R BT.709

log_natively(av.logging.ERROR)


@dataclass(frozen=True)
class Coding:
    """How a video is coded, in FFmpeg's terms. None stands for the container's default, which looks lossless.

    crf : quality, from 0 (lossless or nearly so) to 63.
    """

    codec: str | None = None
    pix_fmt: str | None = None
    crf: float | None = None

    def chosen(self, path: Path) -> str:
        """Return the codec for a file. Raises InputError if FFmpeg cannot write this coding into this container."""
        suffix = path.suffix.lower()
        given = {name: value for name, value in vars(self).items() if value is not None}
        if given and suffix not in VIDEOS:
            raise InputError(f"--{next(iter(given)).replace('_', '-')}: {path} is no video; leave it out")
        usual = "ffv1" if suffix == ".mkv" else "libvpx-vp9" if suffix == ".webm" else "libx264"
        name = self.codec or usual
        try:
            formats = [each.name for each in av.Codec(name, "w").video_formats or ()]
        except av.codec.codec.UnknownCodecError:
            raise InputError(f"--codec {name}: FFmpeg has no such encoder; see ffmpeg -encoders") from None
        if self.pix_fmt is not None and self.pix_fmt not in formats:
            raise InputError(f"--pix-fmt {self.pix_fmt}: {name} takes {', '.join(formats) or 'no pictures'}")
        if self.crf is not None and name == "ffv1":
            raise InputError(f"--crf {self.crf:g}: ffv1 has no loss; leave it out, or add --codec libx264")
        return name


USUAL = Coding()


class Rendered(Protocol):
    """A view that a renderer has drawn."""

    def encoded(self) -> NDArray[np.uint8]: ...

    def linear(self) -> NDArray[np.float32]: ...


class Output(Protocol):
    """Takes rendered frames, each in turn."""

    single: bool

    def write(self, renderer: Rendered, time_s: float) -> None: ...


@runtime_checkable
class FilmOutput(Output, Protocol):
    """An output that also takes parts of a film."""

    def append(self, part: Path, times_s: Sequence[float]) -> NDArray[Any]:
        """Append the frames of a part that another output wrote, and return the last picture.

        part : a lossless video, or a numbered sequence with this output's suffix.
        times_s : time of each frame.
        """


@contextmanager
def open_output(
    path: Path, frames_per_second: float, sound: Path | None = None, coding: Coding = USUAL
) -> Iterator[Output]:
    """Open `path` for rendered frames. Everything written is removed if the block fails.

    A `.png` file and a video hold the encoded view, `.exr` holds the linear view, `name%05d.png` numbers the pictures.
    Raises InputError as `check_output` does, and if another process is writing to `path`.

    sound : file from copied_sound, added to a video. A line reports a container that cannot hold it.
    coding : how a video is coded.
    """
    check_output(path, coding=coding)
    if path.suffix.lower() in VIDEOS:
        with replacing_file(path) as temporary, _VideoOutput(temporary, frames_per_second, sound, coding) as video:
            yield video
    elif is_numbered(path):
        with replacing_sequence(path) as stage:
            yield _SequenceOutput(stage, path.name)
    else:
        with replacing_file(path) as temporary:
            yield _PictureOutput(temporary)


def check_output(path: Path, *, inputs: Iterable[Path] = (), coding: Coding = USUAL) -> None:
    """Raise InputError for an unknown suffix, an unwritable place, an overwritten input, or an impossible coding."""
    check_file(path, suffixes=PICTURES + VIDEOS, inputs=inputs)
    if coding != USUAL:
        coding.chosen(path)
    if is_numbered(path):
        suffix = path.suffix.lower()
        if suffix in VIDEOS:
            raise InputError(f"{path}: only .png and .exr are numbered; write name%05d.png or a plain {suffix}")
        check_sequence(path, inputs=inputs)


def is_film(path: Path) -> bool:
    """Whether an output takes more than one frame."""
    return is_video(path) or is_numbered(path)


def is_video(path: Path) -> bool:
    """Whether an output can hold sound."""
    return path.suffix.lower() in VIDEOS


def write_picture(path: Path, renderer: Rendered) -> None:
    """Write one rendered view: 8-bit PNG of the code values, or float32 EXR of the linear light."""
    if path.suffix.lower() == ".exr":
        exr.write_rgb(path, renderer.linear())
    else:
        write_png(path, renderer.encoded())


def read_written(path: Path) -> NDArray[Any]:
    """Read a picture that `write_picture` wrote."""
    return exr.read_rgb(path) if path.suffix.lower() == ".exr" else read_picture(path)


class _PictureOutput:
    single = True

    def __init__(self, path: Path) -> None:
        self._path = path

    def write(self, renderer: Rendered, time_s: float) -> None:
        write_picture(self._path, renderer)


class _SequenceOutput:
    """Files in a folder, numbered from 0."""

    single = False

    def __init__(self, folder: Path, pattern: str) -> None:
        self._folder, self._pattern = folder, pattern
        self._count = 0

    def write(self, renderer: Rendered, time_s: float) -> None:
        write_picture(self._folder / name_of(self._pattern, self._count), renderer)
        self._count += 1

    def append(self, part: Path, times_s: Sequence[float]) -> NDArray[Any]:
        for number in range(len(times_s)):
            picture = part.with_name(name_of(part.name, number))
            shutil.copyfile(picture, self._folder / name_of(self._pattern, self._count))
            self._count += 1
        return read_written(picture)


class _VideoOutput:
    """H.264 in BT.709 limited range, VP9 for .webm, or lossless FFV1 for .mkv, unless `coding` differs."""

    single = False

    def __init__(self, path: Path, frames_per_second: float, sound: Path | None, coding: Coding) -> None:
        self._codec, self._coding = coding.chosen(path), coding
        self._stack = ExitStack()
        self._container = av.open(f"file:{path}", "w")  # otherwise FFmpeg takes a colon in the name for a protocol
        self._rate = Fraction(frames_per_second).limit_denominator(1001)
        self._pix_fmt = coding.pix_fmt or ("bgr0" if self._codec == "ffv1" else "")
        self._stream: av.VideoStream | None = None
        self._first_s, self._last_s = float("nan"), float("nan")
        self._sound_file = sound
        self._sound: SoundTrack | None = None

    def write(self, renderer: Rendered, time_s: float) -> None:
        self._encode(renderer.encoded(), time_s)

    def append(self, part: Path, times_s: Sequence[float]) -> NDArray[Any]:
        with MediaReader.open(part) as reader:
            for time_s in times_s:
                frame = reader.next_frame(PART_TIMEOUT_S)
                if frame is None:
                    raise InputError(f"{part}: ends early; remove {part.parent} and begin anew")
                width = frame.format.width
                picture = np.stack([plane[:, :width] for plane in frame.planes], axis=-1)
                reader.release(frame)
                self._encode(picture, time_s)
        return picture

    def _encode(self, picture: NDArray[np.uint8], time_s: float) -> None:
        stream = self._stream or self._add_stream(picture)
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        if self._is_yuv(stream):
            # Without this, FFmpeg converts with BT.601 regardless of the stream's tags.
            frame = frame.reformat(
                format=stream.pix_fmt, dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
            )
        if isnan(self._first_s):
            self._first_s = time_s
        self._last_s = time_s
        frame.time_base = CLOCK
        frame.pts = round((time_s - self._first_s) / CLOCK)
        self._container.mux(stream.encode(frame))
        if self._sound is not None:
            self._sound.follow(self._first_s, time_s)

    def _add_stream(self, picture: NDArray[np.uint8]) -> av.VideoStream:
        height, width = picture.shape[:2]
        stream = self._container.add_stream(self._codec, rate=self._rate)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height = width, height
        stream.codec_context.time_base = CLOCK
        even = width % 2 == 0 and height % 2 == 0
        stream.pix_fmt = self._pix_fmt or ("yuv420p" if even else "yuv444p")
        if self._codec != "ffv1":
            stream.options = {"crf": f"{USUAL_CRF if self._coding.crf is None else self._coding.crf:g}"}
        if self._is_yuv(stream):
            context = stream.codec_context
            context.colorspace = context.color_primaries = context.color_trc = BT709
            context.color_range = int(ColorRange.MPEG)
        self._stream = stream
        self._sound = self._opened_sound()
        return stream

    @staticmethod
    def _is_yuv(stream: av.VideoStream) -> bool:
        return str(stream.pix_fmt).startswith("yuv")

    def _opened_sound(self) -> SoundTrack | None:
        if self._sound_file is None:
            return None
        try:
            return self._stack.enter_context(SoundTrack(self._sound_file, self._container))
        except InputError as error:
            tell(str(error))
            return None

    def __enter__(self) -> "_VideoOutput":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._stack:
            if kind is not None:
                with suppress(av.FFmpegError):  # an earlier error has already ended the block
                    self._container.close()
                return
            if self._sound is not None:
                self._sound.follow(self._first_s, self._last_s + float(1 / self._rate))
            if self._stream is not None:
                self._container.mux(self._stream.encode(None))
            self._container.close()
