"""Media -> decoded frames with their time in seconds, decoded by a child process.

A damaged stream can crash or hang a decoder, so it runs in `player.decoding.decoder`: a crash costs a notice and a
restart, never the show.
"""

import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from player.decoding.decoder_link import SILENCE_S, STUCK_S, DecoderLink
from player.decoding.live import live_address
from player.errors import InputError
from player.frames import Frame, MediaInfo, PixelFormat, PlaneShape, format_from_json, slot_bytes

__all__ = ["Frame", "MediaInfo", "MediaReader", "PixelFormat", "PlaneShape"]

RING_SLOTS = 8
LIVE_SLOTS = 3
RING_BYTES = 512 << 20  # what decode-ahead may cost at most; at least two slots
OPENING_S = 60.0
MAX_DEATHS = 5
SKIP_S = 1.0
_POLL_S = 0.1


class MediaReader:
    """Frames of a medium in the order of presentation, decoded ahead in a child process.

        with MediaReader.open(path, loop=True) as reader:
            frame = reader.next_frame(timeout_s=10)   # or poll(), which never waits
            ...
            reader.release(frame)

    At most `RING_SLOTS` (two for huge pictures, one for stills) frames can be held at a time: release them.
    """

    def __init__(self, path: Path | str, *, loop: bool, frames_per_second: float | None, tolerant: bool) -> None:
        self._path, self._loop = path, loop
        self._arguments = {
            "path": str(path),
            "loop": loop,
            "frames_per_second": frames_per_second,
            "tolerant": tolerant,
        }
        self._serial, self._index, self._deaths, self._number = 0, 0, 0, 0
        self._start: dict[str, Any] = {"serial": 0, "time_s": 0.0, "after": False, "offset_s": 0.0}
        self._last_s = self._lap_s = 0.0
        self._failure: str | None = None
        self._notices: list[str] = []
        self.ended = False
        self._began_s = time.monotonic()
        self._info: MediaInfo | None = None
        self._given_up = False
        self._start_child()
        try:
            self._wait_for_opening()
        except BaseException:
            self.close()
            raise

    @classmethod
    def open(
        cls, path: str | Path, *, loop: bool = False, frames_per_second: float | None = None, tolerant: bool = False
    ) -> Self:
        """Start decoding a file, a sequence (`frames/%05d.png`) or a live source (player/decoding/live.py).

        frames_per_second : of a sequence; 25 when None. Videos keep their own times.
        tolerant : pictures that cannot be decoded are left out (Frame.skipped, and a notice) instead of an error.
        Raises InputError, in one line, when it cannot be read; its first frame has been decoded when this returns.
        """
        if frames_per_second is not None and not 0 < frames_per_second <= 1000:
            raise InputError(f"{path}: frame rate {frames_per_second}, expected more than 0 and at most 1000")
        name = path if live_address(str(path)) else Path(path)
        return cls(name, loop=loop, frames_per_second=frames_per_second, tolerant=tolerant)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, _: TracebackType | None) -> None:
        self.close()

    def poll(self) -> Frame | None:
        """The next frame if one is ready, without waiting; None otherwise, and for ever once `ended`.

        Raises InputError once the frames before the medium's damage have been given.
        """
        while not self.ended:
            event = self._child.receive(0.0)
            if event is None:
                self._check_alive()
                return None
            if (frame := self._handle(event)) is not None:
                return frame
        return None

    def next_frame(self, timeout_s: float) -> Frame | None:
        """Wait for the next frame; None at the end.

        Raises InputError when the medium is damaged here, or when `timeout_s` pass without a frame.
        """
        deadline = time.monotonic() + timeout_s
        while not self.ended:
            event = self._child.receive(_POLL_S)
            if event is not None and (frame := self._handle(event)) is not None:
                return frame
            if event is None:
                self._check_alive()
                if time.monotonic() > deadline:
                    raise InputError(f"{self._path}: no frame within {timeout_s:g} s; release frames, or convert it")
        return None

    def release(self, frame: Frame) -> None:
        """Give a frame's slot back to the decoder; its planes must not be read any more."""
        number, slot = frame.slot
        if number == self._number:
            self._child.send({"free": slot})

    def seek(self, time_s: float) -> None:
        """Continue with the frame that is shown at `time_s`, which counts across loops like Frame.time_s.

        A live source just goes on.
        """
        if self.info.live:
            return
        self._serial += 1
        self._failure, self.ended, self._deaths, self._last_s = None, False, 0, 0.0
        time_s = max(time_s, 0.0)
        lap_s = (self._lap_s or self.info.duration_s or 0.0) if self._loop else 0.0
        offset_s = time_s // lap_s * lap_s if lap_s else 0.0
        self._start = {"serial": self._serial, "time_s": time_s - offset_s, "after": False, "offset_s": offset_s}
        self._index = round(time_s * self.info.frames_per_second)
        if self._given_up:
            self._given_up, self._number = False, self._number + 1
            self._start_child()
        else:
            self._child.send({"seek": self._start})

    def skip(self, time_s: float) -> None:
        """Pictures that end before `time_s`, which counts as Frame.time_s, are no longer wanted; a seek forgets it."""
        self._child.send({"skip": time_s, "serial": self._serial})

    def notices(self) -> list[str]:
        """What the user should know and has not been told since the last call."""
        fresh, self._notices = self._notices, []
        return fresh

    @property
    def decoder_pid(self) -> int:
        return self._child.process.pid

    def close(self) -> None:
        """End the decoder and remove its files; frames still held stay readable."""
        self.ended = True
        self._child.close()

    @property
    def info(self) -> MediaInfo:
        assert self._info is not None  # known before anybody else sees this reader
        return self._info

    def _start_child(self, skipped_s: float = 0.0) -> None:
        """Start a decoder; it opens the medium in its own time."""
        start = self._start | {"time_s": self._start["time_s"] + skipped_s}
        self._child = DecoderLink(self._number, self._arguments | {"start": start})
        self._mapped, self._child_began_s = False, time.monotonic()

    def _wait_for_opening(self) -> None:
        while not self._mapped:
            event = self._child.receive(_POLL_S)
            if event is None:
                self._check_alive()
            elif "died" in event:
                raise InputError(f"{self._path}: {event['died']} while opening it; convert or export it again")
            else:
                self._handle(event)

    def _take_opened(self, opened: dict[str, Any]) -> None:
        """The medium is open: give the decoder a ring for its frames."""
        pixels = format_from_json(opened["format"])
        if self._info is None:
            values = {
                name: opened[name]
                for name in ("frames_per_second", "duration_s", "still", "codec", "frames", "live", "sound")
            }
            self._info = MediaInfo(path=self._path, format=pixels, **values)
            self._notices += opened["notices"]
        elif pixels != self.info.format:
            self._failure = f"{self._path}: has changed since it was opened; open it again"
            return
        most = LIVE_SLOTS if self.info.live else RING_SLOTS
        slots = 1 if self.info.still else max(2, min(most, RING_BYTES // slot_bytes(pixels)))
        self._child.make_ring(slots, pixels)

    def _handle(self, event: dict[str, Any]) -> Frame | None:
        """Take one event of the decoder; a frame if it is one that was asked for."""
        if "died" in event:
            self._restart(event["died"])
        elif "opened" in event:
            self._take_opened(event["opened"])
        elif "mapped" in event:
            self._child.remove_ring_file()
            self._mapped = True
        elif "notice" in event:
            self._notices.append(event["notice"])
        elif "error" in event and not self._mapped:
            self._refused(event["error"])
        elif event.get("serial") != self._serial:
            if "frame" in event:
                self._child.send({"free": event["frame"]["slot"]})
        elif "frame" in event:
            return self._frame(event["frame"])
        elif "error" in event:
            self._failure = event["error"]
        elif "end" in event:
            self.ended = True
        if self._failure is not None:
            raise InputError(self._failure)
        return None

    def _frame(self, fields: dict[str, Any]) -> Frame:
        self._deaths = 0
        self._start = {
            "serial": self._serial,
            "time_s": fields["time_s"],
            "after": True,
            "offset_s": fields["offset_s"],
        }
        self._lap_s = fields["lap_s"] or self._lap_s
        # Times never step back, not even where a lap is not as long as the container says.
        time_s = max(fields["offset_s"] + fields["time_s"], self._last_s)
        self._index, self._last_s = self._index + 1 + fields["skipped"], time_s
        planes = self._child.planes(fields["slot"])
        slot = (self._number, fields["slot"])
        times = time_s, fields["duration_s"], fields["decode_s"]
        return Frame(self._index - 1, *times, self.info.format, planes, slot, fields["skipped"])

    def _check_alive(self) -> None:
        """Kill a decoder that is stopped or stuck (its death then arrives as an event); repeat an earlier failure."""
        if self._failure is not None:
            raise InputError(self._failure)
        opening_s = 0.0 if self._mapped else time.monotonic() - self._child_began_s
        if self._child.silent_s() > SILENCE_S or self._child.busy_s > STUCK_S:
            self._child.kill("decoder hung")
        elif opening_s > OPENING_S:
            self._failure = f"{self._path}: not opened within {OPENING_S:g} s; copy it to a local disk, or convert it"
            raise InputError(self._failure)

    def _refused(self, reason: str) -> None:
        """The decoder cannot open the medium: an error at first, later one more reason to try again."""
        if self._info is None:
            raise InputError(reason)
        self._child.kill(reason)
        self._restart(reason)

    def _restart(self, reason: str) -> None:
        """Start a new decoder just after the last frame; skip ahead when it dies there again.

        Does not wait for it: until it has opened the medium there is no frame, and whoever polls holds the last one.
        """
        self._child.close()
        self._deaths += 1
        if self._deaths > MAX_DEATHS:
            self._failure = f"{self._path}: {reason} {MAX_DEATHS} times without a frame; convert the medium"
            self._given_up = True
            return
        skipped_s = 0.0 if self.info.still else SKIP_S * (self._deaths - 1)
        when = f"after {time.monotonic() - self._began_s:.1f} s"
        self._notices.append(f"{self._path}: {reason} {when}; restarted{_skipped(skipped_s)}")
        self._number += 1
        self._start_child(skipped_s)


def _skipped(seconds: float) -> str:
    return f", skipping {seconds:g} s" if seconds else ""
