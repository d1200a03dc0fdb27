"""Videos, pictures and numbered pictures, read by FFmpeg through PyAV. live_source.py reads live sources."""

import re
import struct
from collections.abc import Iterator
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any

import av
from av.codec.hwaccel import HWAccel

from counterlight.errors import InputError
from counterlight.media.decoding.devices import PROCESSOR, devices_of
from counterlight.media.decoding.opening import open_file, open_sequence, reason
from counterlight.media.decoding.pixels import (
    MAX_PIXELS,
    UNTAGGED,
    Samples,
    Tags,
    brightest_nits,
    describe,
    display_rotation,
    peak_notice,
    unpack,
)
from counterlight.media.decoding.source import TIME_SLACK_S, Decoded, Sequence, is_wanted
from counterlight.media.frames import MediaInfo
from counterlight.media.medium import Medium

# The tags that FFmpeg 7's decoder reads and that describe how pixels are stored. In strict mode the decoder refuses all
# other tags, such as orientation, page or software, which other programs write.
KNOWN = {
    *(254, 256, 257, 258, 259, 262, 266, 273, 277, 278, 279, 282, 283, 284),
    *(292, 293, 317, 320, 322, 323, 324, 325, 330, 530),
}
ENTRY = 12  # bytes of an entry in a TIFF index


def known_tags(data: bytes) -> bytes:
    """Return a TIFF file's bytes with only the KNOWN tags in its index. Other files are returned unchanged."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4])
    if order is None or len(data) < 8:
        return data
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    if at + 2 > len(data):
        return data
    (count,) = struct.unpack_from(f"{order}H", data, at)
    first, end = at + 2, at + 2 + count * ENTRY
    if end > len(data):
        return data
    entries = [data[place : place + ENTRY] for place in range(first, end, ENTRY)]
    kept = [entry for entry in entries if struct.unpack_from(f"{order}H", entry)[0] in KNOWN]
    index = struct.pack(f"{order}H", len(kept)) + b"".join(kept) + b"\0" * 4  # 0 means that no further picture follows
    return data[:at] + index + data[at + len(index) :]


DEFAULT_RATE = 25.0
_PICTURE_CODECS = {"gif", "apng", "webp", "webp_anim"}
_CENTERED_CODECS = {"mjpeg", "mjpegb", "mpeg1video", "webp", "jpegls"}
_AGAIN = "copy or export it again"
_FIX = f"it is damaged: {_AGAIN}"


class FfmpegSource:
    """A medium that FFmpeg reads: a video, a picture, or numbered pictures.

    tolerant : skip pictures that cannot be decoded, and accept an early end. One notice reports this.
    hwdec : device that decodes films, see devices.py.
    """

    def __init__(
        self, medium: Medium, sequence: Sequence | None, *, tolerant: bool = False, hwdec: str = PROCESSOR
    ) -> None:
        self._medium, self._sequence, self._tolerant = medium, sequence, tolerant
        self._device: HWAccel | None = None
        self.path = Path(medium.name) if medium.live() is None else medium.name
        self.notices: list[str] = []
        self._damage: InputError | None = None  # the first damage that was tolerated
        self._reported = False
        self.end_s = 0.0
        self._picture = False
        self._origin: int | None = None
        self._open()
        self._fresh: Iterator[Decoded] | None = self._read()
        first, tags = self._first(self._fresh)
        if hwdec != PROCESSOR and sequence is None and not (self._still or self._picture):
            first = self._decode_on(hwdec)
        self.info = self._describe(first, tags)
        self._check_trailer()

    def lap(self, from_s: float, *, after: bool) -> Iterator[Decoded | str]:
        """See Source. Decodes from the key frame before `from_s` on, and drops earlier pictures.

        Raises InputError for damage; if tolerant, only if no picture can be decoded.
        """
        fresh, self._fresh = self._fresh, None  # the pictures that were decoded while opening
        pictures, good = fresh if fresh is not None and from_s <= 0 else self._from(from_s), 0
        for picture in pictures:
            if is_wanted(picture.time_s, picture.time_s + picture.duration_s, from_s, after=after):
                self._check_picture(picture)
                good += not picture.corrupt
                yield from self._news()
                yield picture
        if self._damage is not None and not good and from_s <= 0:
            raise self._damage
        yield from self._news()

    def _news(self) -> Iterator[str]:
        """Yield one line about tolerated damage, only the first time."""
        if self._damage is not None and not self._reported:
            self._reported = True
            yield f"{str(self._damage).removesuffix(f'; {_FIX}')}; left out, as all that cannot be decoded"

    def _tolerate(self, damage: InputError) -> None:
        """Record a damage if tolerant, otherwise raise it."""
        if not self._tolerant:
            raise damage from None
        self._damage = self._damage or damage

    def _open(self) -> None:
        path, options = Path(self.path), {"max_pixels": str(MAX_PIXELS)}
        try:
            if self._sequence is None:
                self._container = open_file(self._medium, path, options, self._device)
            else:
                rate = Fraction(self._sequence.rate).limit_denominator(100_000)
                options |= {"framerate": str(rate), "start_number": str(self._sequence.start)}
                self._container = open_sequence(self._medium, path, options)
        except (av.FFmpegError, OSError) as error:
            why = f"FFmpeg cannot read it ({reason(error)})"
            raise InputError(f"{self.path}: {why}; it is of an unknown kind or begins damaged: {_AGAIN}") from None
        self._stream = self._video_stream()

    def _video_stream(self) -> av.VideoStream:
        """Choose FFmpeg's best video stream, and configure its decoder."""
        container_name = self._container.format.name
        stream = self._container.streams.best("video")
        if stream is None or stream.disposition & stream.disposition.attached_pic:
            raise InputError(f"{self.path}: holds no video or picture; choose a file with one")
        assert isinstance(stream, av.VideoStream)
        context: av.VideoCodecContext | None = stream.codec_context
        if context is None:
            raise InputError(f"{self.path}: FFmpeg does not know its video codec; export it in another, such as H.264")
        self._codec = context.name
        width, height = (context.width, context.height) if context.width else self._size_in_header()
        if width * height > MAX_PIXELS:
            claim = f"claims {width}x{height} pixels, at most {MAX_PIXELS} are shown"
            raise InputError(f"{self.path}: {claim}; scale it down, unless it is damaged")
        pictures = container_name == "image2" or container_name.endswith("_pipe")
        self._picture = pictures or self._codec in _PICTURE_CODECS
        context.options = {"max_pixels": str(MAX_PIXELS)} | ({"err_detect": "explode"} if self._picture else {})
        stream.thread_type = "AUTO"
        return stream

    def _size_in_header(self) -> tuple[int, int]:
        """Return (width, height) of a PNG, whose size FFmpeg does not state if it exceeds the limit; otherwise 0, 0."""
        if self._codec != "png" or self._sequence is not None:
            return 0, 0
        with Path(self.path).open("rb") as file:
            header = file.read(24)
        return struct.unpack_from(">II", header, 16) if len(header) == 24 else (0, 0)

    def _first(self, pictures: Iterator[Decoded]) -> tuple[Decoded, Tags]:
        """Decode the first picture and put it back. A medium without a second picture is a still."""
        first = next(pictures, None)
        if first is None:
            raise self._damage or InputError(f"{self.path}: FFmpeg decodes no picture from it; {_FIX}")
        tags = self._tags
        second: Iterator[Decoded] = iter(())
        self._still = self._sequence is None and self._stream.frames <= 1
        if self._still:
            try:
                second = iter([next(pictures)])
                self._still = False
            except StopIteration:
                pass
            except InputError as error:
                second, self._still = _failing(error), False
        self._fresh = chain([first], second, pictures)
        return first, tags

    def _decode_on(self, hwdec: str) -> Decoded:
        """Start again on a GPU, or on the processor with a notice if no GPU can decode. Returns the first picture.

        The tags come from the processor's decoder, because the pictures that PyAV downloads from a GPU have none.
        """
        why = "no such device here"
        for self._device in devices_of(hwdec):
            try:
                first = self._begin_again()
                if self._stream.codec_context.is_hwaccel:
                    return first
                why = f"it knows no {self._codec}"
            except (av.FFmpegError, OSError, InputError, StopIteration) as error:
                why = reason(error)
        self.notices.append(f"{self.path}: --hwdec {hwdec} does not decode it ({why}); the processor does")
        self._device = None
        return self._begin_again()

    def _begin_again(self) -> Decoded:
        """Reopen the medium with the present device. Returns the first picture, which is also put back."""
        pictures = self._reopened()
        first = next(pictures)
        self._fresh = chain([first], pictures)
        return first

    def _reopened(self) -> Iterator[Decoded]:
        self._container.close()
        self._open()
        return self._read()

    def _describe(self, first: Decoded, tags: Tags) -> MediaInfo:
        try:
            aspect = float(self._stream.sample_aspect_ratio or 1)
            pixels = describe(first.samples, tags, rotation=self._rotation, pixel_aspect=aspect)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None
        self._plan = (pixels.layout, pixels.depth, pixels.planes)
        notice = peak_notice(pixels)
        self.notices += [f"{self.path}: {notice}"] if notice else []
        duration = None if self._still else self._declared_s()
        count = self._declared_frames() or (1 if self._still else None)
        sound = bool(self._container.streams.audio)
        return MediaInfo(self.path, pixels, self._rate(), duration, self._still, self._codec, count, sound=sound)

    def _rate(self) -> float:
        rate = self._sequence.rate if self._sequence else self._stream.average_rate or self._stream.guessed_rate
        return float(rate or DEFAULT_RATE)

    def _declared_frames(self) -> int | None:
        return self._sequence.count if self._sequence else self._stream.frames or None

    def _declared_s(self) -> float | None:
        """Return the duration in seconds that the video stream declares, None if it declares none."""
        if self._sequence:
            return self._sequence.count / self._sequence.rate
        time_base = self._stream.time_base or Fraction(0)
        if self._stream.duration is not None and time_base:
            declared = float(self._stream.duration * time_base)
        # Matroska states a duration in this form
        elif clock := re.fullmatch(r"(\d+):(\d+):(\d+\.?\d*)", self._stream.metadata.get("DURATION", "")):
            declared = sum(float(part) * unit for part, unit in zip(clock.groups(), (3600, 60, 1), strict=True))
        else:
            return None
        # These two formats count the duration from time 0, even if the first picture comes later.
        counts_from_zero = self._container.format.name in ("avi", "matroska,webm")
        return declared - max(0.0, float((self._origin or 0) * time_base)) if counts_from_zero else declared

    def _from(self, from_s: float) -> Iterator[Decoded]:
        """Return pictures from a key frame at or before `from_s`."""
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
        # Without timestamps, or with a bad index: decode from the start, which always works.
        return self._reopened()

    def _read(self, *, resume: bool = False) -> Iterator[Decoded]:
        """Decode from the container's position to its end, in presentation order and with growing times."""
        count, end_s, next_s = 0, 0.0, 0.0
        for frame in self._frames(resume):
            if frame.pts is None or frame.time_base is None:
                time_s = next_s
            else:
                self._origin = frame.pts if self._origin is None else self._origin
                time_s = float((frame.pts - self._origin) * frame.time_base)
            time_s = max(time_s, next_s - 0.5 / self._rate()) if count else time_s  # timestamps may decrease
            duration_s = (
                float(frame.duration * frame.time_base) if frame.duration and frame.time_base else 1 / self._rate()
            )
            count, next_s = count + 1, time_s + duration_s
            end_s = max(end_s, next_s)
            yield Decoded(time_s, duration_s, self._samples(frame, count), frame.is_corrupt)
        try:
            self._check_complete(None if resume else count, end_s)
        except InputError as error:
            self._tolerate(error)
        self.end_s = end_s

    def _frames(self, resume: bool) -> Iterator[av.VideoFrame]:
        count = 0
        try:
            for packet in self._container.demux(self._stream):
                if self._picture and self._codec == "mjpeg" and packet.size and not _jpeg_ends(bytes(packet)):
                    self._tolerate(self._damaged(count, "the JPEG ends before its end marker"))
                    continue
                if self._codec == "tiff" and packet.size:
                    packet = _with(packet, known_tags(bytes(packet)))
                for frame in self._decode(packet, None if resume else count):
                    count += 1
                    yield frame
        except (av.FFmpegError, OSError, MemoryError) as error:
            self._tolerate(self._undecoded(None if resume else count, error))

    def _decode(self, packet: "av.Packet[av.VideoStream]", number: int | None) -> list[av.VideoFrame]:
        """Return the pictures that a packet completes.

        number : number of the first picture, for an error message.
        """
        try:
            return [frame for frame in packet.decode() if isinstance(frame, av.VideoFrame)]
        except (av.FFmpegError, OSError, MemoryError) as error:
            self._tolerate(self._undecoded(number, error))
            return []

    def _samples(self, frame: av.VideoFrame, count: int) -> Samples:
        if count == 1 and self._device is None:
            self._rotation, self.flip_rows = display_rotation(frame)
            self._tags = Tags(
                int(frame.colorspace),
                int(frame.color_trc or UNTAGGED),
                self._picture,
                self._is_centered(),
                int(frame.color_primaries or UNTAGGED),
                brightest_nits(frame),
            )
        try:
            return unpack(frame, picture=self._picture)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None

    def _is_centered(self) -> bool:
        return self._codec in _CENTERED_CODECS

    def _check_picture(self, picture: Decoded) -> None:
        """Raise InputError for a picture that differs from the first in format, or for damage that is not tolerated."""
        number = round(picture.time_s * self.info.frames_per_second)
        if picture.corrupt:
            self._tolerate(self._damaged(number, "its data is damaged"))
        if difference := self._unlike_the_first(picture):
            raise InputError(
                f"{self.path}: frame {number} is {difference} like the first; re-encode it at one size and format"
            )

    def _unlike_the_first(self, picture: Decoded) -> str:
        """Return a text such as `64x48, expected 32x24`, or "" for the format of the first picture."""
        pixels, found, expected = self.info.format, picture.samples, self._plan
        if tuple((p.shape[1], p.shape[0]) for p in found.planes) != tuple((s.width, s.height) for s in expected[2]):
            height, width = found.planes[0].shape
            return f"{width}x{height}, expected {pixels.width}x{pixels.height}"
        if (found.layout, found.depth) != expected[:2]:
            return f"{found.layout} of {found.depth} bits, expected {pixels.layout} of {pixels.depth} bits"
        return ""

    def _check_complete(self, count: int | None, end_s: float) -> None:
        """Raise InputError if the medium ends clearly before its declared end.

        Edit lists shorten the time but not the declared count, and containers round durations. Therefore both time and
        count must be short, by more than 2 % and three frames.
        """
        if self._picture and not self._sequence:
            return
        frames, duration, rate = self._declared_frames(), self._declared_s(), self._rate()
        by_time, by_count = duration is not None, frames is not None and count is not None
        lacks_time = duration is not None and duration - end_s > max(3 / rate, 0.02 * duration)
        tolerated = 0 if self._sequence else max(3, 0.02 * (frames or 0))
        lacks_frames = frames is not None and count is not None and frames - count > tolerated
        if (by_time or by_count) and lacks_time >= by_time and lacks_frames >= by_count:
            found = f"{count} of {frames} frames" if by_count else f"{end_s:.2f} of {duration:.2f} s"
            raise InputError(f"{self.path}: ends early: {found}; the file is truncated, copy or export it again")

    def _check_trailer(self) -> None:
        """Raise InputError for a GIF without its trailer, the last byte `;`. FFmpeg accepts a cut GIF."""
        if self._codec != "gif":
            return
        path = Path(self.path)
        with path.open("rb") as file:
            file.seek(-min(64, path.stat().st_size), 2)
            if not file.read().rstrip(b"\0").endswith(b";"):
                raise self._damaged(None, "the GIF ends before its trailer")

    def _undecoded(self, count: int | None, error: BaseException) -> InputError:
        if self._picture and isinstance(error, av.ArgumentError):  # decoders of pictures refuse a size in this way
            return InputError(f"{self.path}: more than {MAX_PIXELS} pixels, or its size is damaged; scale it down")
        return self._damaged(count, reason(error))

    def _damaged(self, count: int | None, reason: str) -> InputError:
        number = "" if count is None else f"frame {count} cannot be decoded: "
        return InputError(f"{self.path}: {number}{reason}; {_FIX}")


def _jpeg_ends(data: bytes) -> bool:
    """Whether an end marker follows the last start of scan. FFmpeg silently fills a cut JPEG with gray."""
    return data.rfind(b"\xff\xd9") > data.rfind(b"\xff\xda")


def _failing(error: InputError) -> Iterator[Decoded]:
    """Return an iterator that raises this error on its first step."""
    yield from (_throw(error) for _ in range(1))


def _throw(error: InputError) -> Decoded:
    raise error


def _with(packet: "av.Packet[av.VideoStream]", data: bytes) -> "av.Packet[av.VideoStream]":
    """Return a packet of the same stream and times with other bytes."""
    other: Any = av.Packet(data)
    other.stream, other.pts, other.dts, other.time_base = packet.stream, packet.pts, packet.dts, packet.time_base
    other.duration = packet.duration
    made: av.Packet[av.VideoStream] = other
    return made
