"""Cameras and streams that FFmpeg opens: no end, no seeking; a source that breaks off is opened again."""

import time
from collections.abc import Iterator
from dataclasses import replace

import av

from player.decoding.ffmpeg_source import FfmpegSource, reason
from player.decoding.live import LiveAddress
from player.decoding.source import Decoded
from player.errors import InputError

OPEN_S, READ_S = 10.0, 5.0  # FFmpeg's patience with a network
RETRY_S = (0.5, 1.0, 2.0, 5.0)  # between attempts to open it again; the last one for ever
_FIX = "check the address, and that nobody else uses the device"
_OPTIONS = {"fflags": "nobuffer", "flags": "low_delay"}


class LiveSource(FfmpegSource):
    """A source whose pictures are due when they arrive: their time is that of this computer's clock."""

    def __init__(self, name: str, live: LiveAddress) -> None:
        self._live = live
        self._began_s = time.monotonic()
        try:
            super().__init__(name, None)
        except av.FFmpegError as error:
            raise InputError(f"{name}: no picture comes ({reason(error)}); {_FIX}") from None
        self.info = replace(self.info, live=True, still=False, duration_s=None, frames=None)

    def lap(self, from_s: float, *, after: bool) -> Iterator[Decoded | str]:
        """Pictures without end, and a line for the user whenever the source is lost or back."""
        fresh, self._fresh = self._fresh, None
        pictures, last_s = fresh if fresh is not None else self._read(), -1.0
        while True:
            try:
                for picture in pictures:
                    self._check_picture(picture)
                    last_s = max(time.monotonic() - self._began_s, last_s + 1e-6)
                    yield replace(picture, time_s=last_s)
                why = "it ended"
            except av.FFmpegError as error:
                why = reason(error)
            yield f"{self.path}: lost ({why}); reconnecting"
            yield from self._reconnect()
            pictures = self._read()

    def _reconnect(self) -> Iterator[str]:
        """Open the source again, as often as it takes. Empty lines are signs of life."""
        self._container.close()
        for attempt in range(1 << 62):
            wait_s = RETRY_S[min(attempt, len(RETRY_S) - 1)]
            until = time.monotonic() + wait_s
            while time.monotonic() < until:
                time.sleep(0.1)
                yield ""
            try:
                self._open()
                break
            except InputError:
                continue
        yield f"{self.path}: back"

    def _open(self) -> None:
        address, kind = self._live.address, self._live.format
        try:
            self._container = av.open(
                address, format=kind, options=dict(_OPTIONS), timeout=(OPEN_S, READ_S), metadata_errors="replace"
            )
        except (av.FFmpegError, OSError, ValueError) as error:
            raise InputError(f"{self.path}: FFmpeg cannot open it ({reason(error)}); {_FIX}") from None
        self._stream = self._video_stream()
        self._stream.thread_type = "SLICE"  # frame threads would hold pictures back

    def _frames(self, resume: bool) -> Iterator[av.VideoFrame]:
        """Decode what arrives; FFmpeg's errors are for `lap`. Filters make pictures at once: they are paced."""
        began_s = time.monotonic()
        for packet in self._container.demux(self._stream):
            try:
                frames = packet.decode()
            except av.InvalidDataError:  # a packet was lost: pictures go on with the next key frame
                continue
            for frame in frames:
                assert isinstance(frame, av.VideoFrame)
                if self._live.format == "lavfi" and frame.time is not None:
                    time.sleep(max(0.0, began_s + frame.time - time.monotonic()))
                yield frame

    def _declared_frames(self) -> int | None:
        return None

    def _declared_s(self) -> float | None:
        return None

    def _check_trailer(self) -> None: ...
