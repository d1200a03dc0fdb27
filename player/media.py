"""Media files and picture sequences as laps of decoded pictures; runs inside the decoder process only.

A lap is one pass from a given time to the end. FFmpeg is reached through PyAV, OpenEXR through player/exr.py.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Protocol

import av
import numpy as np

from player import exr
from player.errors import InputError
from player.pixels import MAX_PIXELS, Samples, Tags, check_finite, describe, display_rotation, hdr_notice, unpack
from player.video import MediaInfo, PixelFormat

SEQUENCE_RATE = 25.0
TIME_SLACK_S = 1e-6  # far below one frame, far above the rounding of a float64 time
_PICTURE_CODECS = {"gif", "apng", "webp", "webp_anim"}
_CENTERED_CODECS = {"mjpeg", "mjpegb", "mpeg1video", "webp", "jpegls"}
_TEXT_ART = {"tty", "bin", "xbin", "adf", "idf"}  # FFmpeg would draw any text file as a film
_PATTERN = re.compile(r"%0?(\d*)d")


@dataclass(frozen=True)
class Decoded:
    """One picture of a medium: seconds since the first one, and its samples (valid until the next is asked for)."""

    time_s: float
    duration_s: float
    samples: Samples


class Source(Protocol):
    """A medium that can be played from any time."""

    info: MediaInfo
    end_s: float
    flip_rows: bool
    notices: list[str]

    def lap(self, from_s: float, *, after: bool) -> Iterator[Decoded]:
        """Yield the pictures to the end: from the one shown at `from_s`, or the first that starts after it."""


def open_source(path: Path, frames_per_second: float | None) -> Source:
    """Open a file, or a printf pattern such as `frames/%05d.png`, and decode its first picture."""
    if _PATTERN.search(path.name) and not path.exists():
        start, paths = _sequence(path)
        rate = frames_per_second or SEQUENCE_RATE
        if path.suffix.lower() == ".exr":
            return ExrSource(path, paths, rate)
        return VideoSource(path, Sequence(start, len(paths), rate))
    _check_file(path)
    return ExrSource(path, [path], SEQUENCE_RATE) if path.suffix.lower() == ".exr" else VideoSource(path, None)


@dataclass(frozen=True)
class Sequence:
    """Consecutively numbered pictures."""

    start: int
    count: int
    rate: float


def _sequence(pattern: Path) -> tuple[int, list[Path]]:
    """First number and files of a printf pattern; InputError when there is none or one is missing."""
    before, width, after = _PATTERN.split(pattern.name, maxsplit=1)
    digits = re.compile(re.escape(before) + rf"(\d{{{width or 1},}})" + re.escape(after.replace("%%", "%")))
    if not pattern.parent.is_dir():
        raise InputError(f"{pattern.parent}: no such folder; check the sequence's path")
    names = [match for entry in pattern.parent.iterdir() if (match := digits.fullmatch(entry.name))]
    numbered = {int(match[1]): pattern.parent / match[0] for match in names}
    if not numbered:
        raise InputError(f"{pattern}: no file matches this pattern; check its name and its number of digits")
    first, last = min(numbered), max(numbered)
    missing = next((n for n in range(first, last + 1) if n not in numbered), None)
    if missing is not None:
        raise InputError(
            f"{pattern}: number {missing} is missing between {first} and {last}; add it or renumber the files"
        )
    return first, [numbered[n] for n in range(first, last + 1)]


def _check_file(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file, or a sequence such as {path / '%05d.png'}")
    if not path.exists():
        raise InputError(f"{path}: no such file; check its name")
    if not path.is_file():
        raise InputError(f"{path}: not a regular file; copy the medium to one")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: empty (0 bytes); copy or export it again")


class VideoSource:
    """Whatever FFmpeg reads: videos, pictures, numbered pictures."""

    def __init__(self, path: Path, sequence: Sequence | None) -> None:
        self.path, self._sequence = path, sequence
        self.notices: list[str] = []
        self.end_s = 0.0
        self._picture = False
        self._origin: int | None = None
        self._open()
        self._fresh: Iterator[Decoded] | None = self._read()
        first, tags = self._first(self._fresh)
        self.info = self._describe(first, tags)
        self._check_trailer()

    def lap(self, from_s: float, *, after: bool) -> Iterator[Decoded]:
        """See Source. Decodes from the key frame before `from_s` and drops what comes too early."""
        if self._fresh is not None:  # the pictures that opening has decoded
            pictures, self._fresh = self._fresh, None
        else:
            pictures = self._from(from_s)
        for picture in pictures:
            self._check_same(picture)
            if picture.time_s > from_s + TIME_SLACK_S or (not after and _end(picture) > from_s + TIME_SLACK_S):
                yield picture

    def _open(self) -> None:
        options = {"protocol_whitelist": "file", "pattern_type": "none", "max_pixels": str(MAX_PIXELS)}
        if self._sequence is not None:
            rate = Fraction(self._sequence.rate).limit_denominator(100_000)
            options |= {"framerate": str(rate), "start_number": str(self._sequence.start), "pattern_type": "sequence"}
        try:
            self._container = av.open(
                f"file:{self.path}",
                format="image2" if self._sequence else None,
                options=options,
                metadata_errors="replace",
            )
        except (av.FFmpegError, OSError) as error:
            raise InputError(f"{self.path}: FFmpeg cannot read it ({_reason(error)}); {_FIX}") from None
        self._stream = self._video_stream()

    def _video_stream(self) -> av.VideoStream:
        """Choose FFmpeg's best video stream and set its decoder up."""
        container_name = self._container.format.name
        stream = self._container.streams.best("video")
        if stream is None or container_name in _TEXT_ART or stream.disposition & stream.disposition.attached_pic:
            raise InputError(f"{self.path}: holds no video or picture; choose a file with one")
        assert isinstance(stream, av.VideoStream)
        context = stream.codec_context
        if context.width * context.height > MAX_PIXELS:
            claim = f"claims {context.width}x{context.height} pixels, at most {MAX_PIXELS} are shown"
            raise InputError(f"{self.path}: {claim}; scale it down, unless it is damaged")
        self._codec = context.name
        pictures = container_name == "image2" or container_name.endswith("_pipe")
        self._picture = pictures or self._codec in _PICTURE_CODECS
        context.options = {"max_pixels": str(MAX_PIXELS)} | ({"err_detect": "explode"} if self._picture else {})
        stream.thread_type = "AUTO"
        return stream

    def _first(self, pictures: Iterator[Decoded]) -> tuple[Decoded, Tags]:
        """Decode the first picture and put it back; one that no second follows is a still."""
        first = next(pictures, None)
        if first is None:
            raise InputError(f"{self.path}: FFmpeg decodes no picture from it; {_FIX}")
        tags = self._tags
        second: Iterator[Decoded] = iter(())
        self._still = self._sequence is None and self._stream.frames <= 1
        if self._still:
            # The codec may reuse its buffer for the second picture.
            first = replace(first, samples=_copy(first.samples))
            try:
                second = iter([next(pictures)])
                self._still = False
            except StopIteration:
                pass
            except InputError as error:
                second, self._still = _raise(error), False
        self._fresh = chain([first], second, pictures)
        return first, tags

    def _describe(self, first: Decoded, tags: Tags) -> MediaInfo:
        try:
            aspect = float(self._stream.sample_aspect_ratio or 1)
            pixels = describe(first.samples, tags, rotation=self._rotation, pixel_aspect=aspect)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None
        self._plan = (pixels.layout, pixels.depth, pixels.planes)
        notice = hdr_notice(tags.transfer)
        self.notices += [f"{self.path}: {notice}"] if notice else []
        duration = None if self._still else self._declared_s()
        count = self._declared_frames() or (1 if self._still else None)
        return MediaInfo(self.path, pixels, self._rate(), duration, self._still, self._codec, count)

    def _rate(self) -> float:
        rate = self._sequence.rate if self._sequence else self._stream.average_rate or self._stream.guessed_rate
        return float(rate or SEQUENCE_RATE)

    def _declared_frames(self) -> int | None:
        return self._sequence.count if self._sequence else self._stream.frames or None

    def _declared_s(self) -> float | None:
        """How long the video stream says it is, in seconds; None when it does not say."""
        if self._sequence:
            return self._sequence.count / self._sequence.rate
        if self._stream.duration is not None and self._stream.time_base is not None:
            return float(self._stream.duration * self._stream.time_base)
        clock = re.fullmatch(r"(\d+):(\d+):(\d+\.?\d*)", self._stream.metadata.get("DURATION", ""))  # Matroska
        return (
            sum(float(part) * unit for part, unit in zip(clock.groups(), (3600, 60, 1), strict=True)) if clock else None
        )

    def _from(self, from_s: float) -> Iterator[Decoded]:
        """Pictures from a key frame at or before `from_s`."""
        if self._origin is not None and self._stream.time_base is not None:
            try:
                target = self._origin + int(max(from_s, 0.0) / self._stream.time_base)
                self._container.seek(target, stream=self._stream, backward=True)
                pictures = self._read(resume=True)
                first = next(pictures, None)
                if first is not None and first.time_s <= from_s + TIME_SLACK_S:
                    return chain([first], pictures)
            except (av.FFmpegError, InputError):
                pass
        # No timestamps, no index, or one that leads past the target: from the start, which always works.
        self._container.close()
        self._open()
        return self._read()

    def _read(self, *, resume: bool = False) -> Iterator[Decoded]:
        """Decode from the container's position to its end, in presentation order with growing times."""
        count, end_s, next_s = 0, 0.0, 0.0
        for frame in self._frames(resume):
            if frame.pts is None or frame.time_base is None:
                time_s = next_s
            else:
                self._origin = frame.pts if self._origin is None else self._origin
                time_s = float((frame.pts - self._origin) * frame.time_base)
            if frame.is_corrupt and not resume:
                raise self._damaged(count, "its data is damaged")
            time_s = max(time_s, next_s - 0.5 / self._rate()) if count else time_s  # timestamps that step back
            duration_s = (
                float(frame.duration * frame.time_base) if frame.duration and frame.time_base else 1 / self._rate()
            )
            count, next_s = count + 1, time_s + duration_s
            end_s = max(end_s, next_s)
            yield Decoded(time_s, duration_s, self._samples(frame, count))
        self._check_complete(None if resume else count, end_s)
        self.end_s = end_s

    def _frames(self, resume: bool) -> Iterator[av.VideoFrame]:
        count = 0
        try:
            for packet in self._container.demux(self._stream):
                if self._picture and self._codec == "mjpeg" and packet.size and not _jpeg_ends(bytes(packet)):
                    raise self._damaged(count, "the JPEG ends before its end marker")
                for frame in packet.decode():
                    assert isinstance(frame, av.VideoFrame)
                    count += 1
                    yield frame
        except (av.FFmpegError, OSError, MemoryError) as error:
            raise self._damaged(None if resume else count, _reason(error)) from None

    def _samples(self, frame: av.VideoFrame, count: int) -> Samples:
        if count == 1:
            self._rotation, self.flip_rows = display_rotation(frame)
            self._tags = Tags(
                int(frame.colorspace),
                int(frame.color_range),
                int(frame.color_trc or 2),
                self._picture,
                self._is_centered(),
            )
        try:
            return unpack(frame, picture=self._picture)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None

    def _is_centered(self) -> bool:
        return self._codec in _CENTERED_CODECS

    def _check_same(self, picture: Decoded) -> None:
        pixels = self.info.format
        found, expected = picture.samples, self._plan
        if tuple((p.shape[1], p.shape[0]) for p in found.planes) != tuple((s.width, s.height) for s in expected[2]):
            height, width = found.planes[0].shape
            size = f"{width}x{height}, expected {pixels.width}x{pixels.height}"
        elif (found.layout, found.depth) != expected[:2]:
            size = f"{found.layout} of {found.depth} bits, expected {pixels.layout} of {pixels.depth} bits"
        else:
            return
        number = round(picture.time_s * self.info.frames_per_second)
        raise InputError(f"{self.path}: frame {number} is {size} like the first; re-encode it at one size and format")

    def _check_complete(self, count: int | None, end_s: float) -> None:
        """Raise InputError when the medium stops clearly before the end that it declares.

        Edit lists shorten the time but not the declared count, and containers round durations: hence both must fall
        short, by more than 2 % and three frames.
        """
        frames, duration = self._declared_frames(), self._declared_s()
        rate = self._rate()
        short_time = duration is None or duration - end_s > max(3 / rate, 0.02 * duration)
        short_count = (
            frames is None or count is None or frames - count > (0 if self._sequence else max(3, 0.02 * frames))
        )
        known = duration is not None or (frames is not None and count is not None)
        if known and short_time and short_count and not self._picture_alone():
            found = (
                f"{count} of {frames} frames" if frames and count is not None else f"{end_s:.2f} of {duration:.2f} s"
            )
            raise InputError(f"{self.path}: ends early: {found}; the file is truncated, copy or export it again")

    def _picture_alone(self) -> bool:
        return self._picture and self._sequence is None

    def _check_trailer(self) -> None:
        """A cut GIF decodes without complaint: its last byte must be the trailer `;`."""
        if self._codec != "gif":
            return
        with self.path.open("rb") as file:
            file.seek(-min(64, self.path.stat().st_size), 2)
            if not file.read().rstrip(b"\0").endswith(b";"):
                raise self._damaged(None, "the GIF ends before its trailer")

    def _damaged(self, count: int | None, reason: str) -> InputError:
        number = "" if count is None else f"frame {count} cannot be decoded: "
        return InputError(f"{self.path}: {number}{reason}; {_FIX}")


class ExrSource:
    """One OpenEXR picture or a numbered sequence, as linear radiance."""

    def __init__(self, path: Path, paths: list[Path], rate: float) -> None:
        self.notices: list[str] = []
        self.flip_rows = False
        self._paths, self._rate = paths, rate
        self.end_s = len(paths) / rate
        self._first: Samples | None = _read_exr(paths[0])
        tags = Tags(_UNTAGGED, _UNTAGGED, _UNTAGGED, picture=True, centered=False)
        pixels: PixelFormat = describe(self._first, tags, rotation=0, pixel_aspect=1.0)
        still = len(paths) == 1
        self.info = MediaInfo(path, pixels, rate, None if still else self.end_s, still, "exr", len(paths))

    def lap(self, from_s: float, *, after: bool) -> Iterator[Decoded]:
        for i, path in enumerate(self._paths):
            start, end = i / self._rate, (i + 1) / self._rate
            if start > from_s + TIME_SLACK_S or (not after and end > from_s + TIME_SLACK_S):
                samples, self._first = (self._first if i == 0 else None) or _read_exr(path), None
                self._check_same(path, samples)
                yield Decoded(start, 1 / self._rate, samples)

    def _check_same(self, path: Path, samples: Samples) -> None:
        height, width = samples.planes[0].shape
        expected = self.info.format
        if (width, height) != (expected.width, expected.height):
            size = f"{width}x{height}, expected {expected.width}x{expected.height}"
            raise InputError(f"{path}: {size} like the first of its sequence; export the sequence at one size")


_UNTAGGED = 2
_FIX = "it is damaged or no medium that FFmpeg knows: copy or export it again"


def _read_exr(path: Path) -> Samples:
    header = exr.read_header(path)
    if header.width * header.height > MAX_PIXELS:
        raise InputError(
            f"{path}: claims {header.width}x{header.height} pixels, at most {MAX_PIXELS} are shown; scale it down"
        )
    linear_rgb = exr.read_rgb(path)
    r, g, b = (np.ascontiguousarray(linear_rgb[..., i]) for i in range(3))
    try:
        check_finite((r, g, b))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return Samples("radiance", 32, (r, g, b))


def _jpeg_ends(data: bytes) -> bool:
    """Whether an end marker follows the last start of scan: FFmpeg fills a cut JPEG with gray and says nothing."""
    return data.rfind(b"\xff\xd9") > data.rfind(b"\xff\xda")


def _copy(samples: Samples) -> Samples:
    y, cb, cr = (plane.copy() for plane in samples.planes)
    return replace(samples, planes=(y, cb, cr), alpha=None if samples.alpha is None else samples.alpha.copy())


def _end(picture: Decoded) -> float:
    return picture.time_s + picture.duration_s


def _raise(error: InputError) -> Iterator[Decoded]:
    raise error
    yield


def _reason(error: BaseException) -> str:
    """FFmpeg's words without the path and the errno, in one line."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(str(text).split()).rstrip(".")
