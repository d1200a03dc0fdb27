"""Cameras and streams that FFmpeg opens. They have no end and cannot seek; a lost source is opened again."""

import time
from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import count

import av

from counterlight.errors import InputError
from counterlight.media.decoding.ffmpeg_source import FfmpegSource
from counterlight.media.decoding.opening import open_live, reason
from counterlight.media.decoding.source import Decoded, FormatChangedError
from counterlight.media.medium import STEADY_S, LiveAddress, Medium

RETRY_S = (0.5, 1.0, 2.0, 5.0)  # pauses between attempts to reopen; the last value repeats
MUTE_S = 10.0  # longest time that packets arrive without a picture; the sender has then changed its streams
DAMAGE_REPORT_S = 60.0  # time between two notices about damaged pictures
_FIX = "check the address, and that nobody else uses the device"
_OPTIONS = {"fflags": "nobuffer", "flags": "low_delay"}


class LiveSource(FfmpegSource):
    """A source whose pictures are due when they arrive. Their times are times of this computer's clock."""

    def __init__(self, medium: Medium, live: LiveAddress) -> None:
        self._live = live
        self._began_s, self._reported_s = time.monotonic(), float("-inf")
        try:
            super().__init__(medium, None, tolerant=True)
        except av.FFmpegError as error:
            raise InputError(f"{medium}: no picture comes ({reason(error)}); {_FIX}") from None
        self.info = replace(self.info, live=True, still=False, duration_s=None, frames=None)

    def lap(self, from_s: float, *, after: bool) -> Iterator[Decoded | str]:
        """Yield pictures without end, and a line for the user whenever the source is damaged, lost or back.

        Raises FormatChangedError if the pictures' format changes.
        """
        fresh, self._fresh = self._fresh, None
        pictures, last_s, tries = fresh if fresh is not None else self._read(), -1.0, 0
        while True:
            connected_s = time.monotonic()
            try:
                for picture in pictures:
                    if difference := self._unlike_the_first(picture):
                        raise FormatChangedError(f"{self.path}: its pictures are {difference}")
                    if picture.corrupt:
                        yield self._damage_report()
                    last_s = max(time.monotonic() - self._began_s, last_s + 1e-6)
                    yield replace(picture, time_s=last_s)
                why = "it ended"
            except (av.FFmpegError, OSError, MemoryError, InputError) as error:
                why = reason(error)
            yield f"{self.path}: lost ({why}); reconnecting"
            tries = 0 if time.monotonic() - connected_s > STEADY_S else tries
            tries = yield from self._reconnect(tries)
            pictures = self._read()

    def _damage_report(self) -> str:
        """Return a notice about damaged pictures, or "" if the last notice is recent."""
        if time.monotonic() - self._reported_s < DAMAGE_REPORT_S:
            return ""
        self._reported_s = time.monotonic()
        return f"{self.path}: damaged pictures are left out"

    def _reconnect(self, tries: int) -> Generator[str, None, int]:
        """Open the source again, with any number of attempts. Yields empty lines meanwhile, as heartbeats.

        tries : recent attempts; the new number is returned.
        """
        self._container.close()
        for attempt in count(tries):
            until = time.monotonic() + RETRY_S[min(attempt, len(RETRY_S) - 1)]
            while time.monotonic() < until:
                time.sleep(0.1)
                yield ""
            with suppress(InputError):
                self._open()
                break
        yield f"{self.path}: back"
        return attempt + 1

    def _open(self) -> None:
        try:
            self._container = open_live(self._live, _OPTIONS)
        except (av.FFmpegError, OSError, ValueError) as error:
            raise InputError(f"{self.path}: FFmpeg cannot open it ({reason(error)}); {_FIX}") from None
        self._stream = self._video_stream()
        self._stream.thread_type = "SLICE"  # frame threads would delay pictures

    def _frames(self, resume: bool) -> Iterator[av.VideoFrame]:
        """Decode the received packets. `lap` handles FFmpeg's errors. Waits for each picture of a filter to be due."""
        began_s = seen_s = time.monotonic()
        for packet in self._container.demux():
            if packet.stream != self._stream:
                if time.monotonic() - seen_s > MUTE_S:
                    raise InputError(f"no picture for {MUTE_S:g} s")
                continue
            seen_s = time.monotonic()
            try:
                frames = packet.decode()
            except av.InvalidDataError:  # a packet was lost; pictures resume with the next key frame
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
