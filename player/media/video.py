"""Reads media as decoded frames with their times in seconds. A child process decodes them.

A damaged stream can crash or hang a decoder, and a medium may never open. Therefore all decoding happens in
`counterlight.media.decoding.decoder`. A crash causes a notice and a restart, and never ends the show.
"""

import time
from dataclasses import asdict, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from counterlight.errors import InputError
from counterlight.media.decoding.child import all_ended
from counterlight.media.decoding.decoder_link import DecoderLink
from counterlight.media.decoding.devices import PROCESSOR
from counterlight.media.frames import Frame, MediaInfo, PixelFormat, PlaneShape, format_from_json
from counterlight.media.medium import STEADY_S, Medium

__all__ = ["Frame", "MediaInfo", "MediaReader", "PixelFormat", "PlaneShape"]

OPENING_S = 10.0  # time limit for opening during a show, which continues meanwhile
LIVE_OPENING_S = 20.0  # FFmpeg waits 10 s for an answer; then a key frame must arrive
PATIENT_OPENING_S = 60.0  # time limit for opening if the caller only waits
MAX_DEATHS = 5
SKIP_S = 1.0
LIVE_RETRY_S = (0.0, 1.0, 2.0, 5.0)  # pauses between a live source's decoders; the last value repeats
HUNG = "decoder hung"
_POLL_S = 0.1


class MediaReader:
    """Frames of a medium in presentation order, decoded ahead in a child process.

        with MediaReader.open(path, loop=True) as reader:
            frame = reader.next_frame(timeout_s=10)   # or poll(), which never waits
            ...
            reader.release(frame)

    Release frames: the ring has RING_SLOTS slots (decoding/laps.py), two for huge pictures, one for stills.
    """

    def __init__(
        self,
        medium: Medium,
        *,
        loop: bool,
        frames_per_second: float | None,
        tolerant: bool,
        hwdec: str,
        opening_s: float,
    ) -> None:
        self.medium, self._loop, self._opening_s = medium, loop, opening_s
        self._live = medium.live() is not None
        self._arguments = {
            "medium": asdict(medium),
            "loop": loop,
            "frames_per_second": frames_per_second,
            "tolerant": tolerant,
            "hwdec": hwdec,
        }
        self._serial, self._index, self._deaths, self._losses, self._number = 0, 0, 0, 0, 0
        self._start: dict[str, Any] = {"serial": 0, "time_s": 0.0, "after": False, "offset_s": 0.0}
        self._last_s = self._lap_s = 0.0
        self._failure: str | None = None
        self._notices: list[str] = []
        self.ended = False
        self._began_s = time.monotonic()
        self._restart_at_s: float | None = None
        self._first: Frame | None = None  # frame that `ready` has received in advance
        self._info: MediaInfo | None = None
        self._given_up = False
        self._start_child()

    @classmethod
    def begin(
        cls,
        medium: Medium | Path | str,
        *,
        loop: bool = False,
        frames_per_second: float | None = None,
        tolerant: bool = False,
        hwdec: str = PROCESSOR,
        opening_s: float | None = None,
    ) -> Self:
        """Begin to open a file, a sequence (`frames/%05d.png`) or a live source (medium.py), without waiting.

        Until `ready` returns True, only `ready` and `close` may be called.
        Raises InputError for names that are not allowed, and if no process can be started.

        frames_per_second : rate of a sequence; None means 25. Videos keep their own times.
        tolerant : skip pictures that cannot be decoded (Frame.skipped, and a notice) instead of raising an error.
        hwdec : device that decodes films: "no" (the processor), "auto", or FFmpeg's name such as `cuda` or
            `vaapi:/dev/dri/renderD128`. If the device fails or its decoder dies, the processor decodes, and a notice
            reports this.
        opening_s : time limit for opening; None for the medium's usual limit.
        """
        if frames_per_second is not None and not 0 < frames_per_second <= 1000:
            raise InputError(f"{medium}: frame rate {frames_per_second}, expected more than 0 and at most 1000")
        known = Medium.of(medium)
        known.check()
        usual_s = OPENING_S if known.live() is None else LIVE_OPENING_S
        return cls(
            known,
            loop=loop,
            frames_per_second=frames_per_second,
            tolerant=tolerant,
            hwdec=hwdec,
            opening_s=usual_s if opening_s is None else opening_s,
        )

    @classmethod
    def open(
        cls,
        medium: Medium | Path | str,
        *,
        loop: bool = False,
        frames_per_second: float | None = None,
        tolerant: bool = False,
        hwdec: str = PROCESSOR,
    ) -> Self:
        """Open a medium as `begin` does, and wait until its first frame has been decoded.

        Raises InputError, in one line, if it cannot be read.
        """
        reader = cls.begin(
            medium,
            loop=loop,
            frames_per_second=frames_per_second,
            tolerant=tolerant,
            hwdec=hwdec,
            opening_s=PATIENT_OPENING_S,
        )
        try:
            while not reader.ready(_POLL_S):
                pass
        except BaseException:
            reader.close()
            raise
        return reader

    def ready(self, wait_s: float = 0.0) -> bool:
        """Whether the medium is open and its first frame is ready. Waits at most `wait_s`.

        Raises InputError if the medium cannot be read or exceeds its time limit.
        """
        if self._first is None and not self.ended:
            self._first = self._take(wait_s)
        return self._info is not None and (self._first is not None or self.ended)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, _: TracebackType | None) -> None:
        self.close()
        all_ended()

    def poll(self) -> Frame | None:
        """Return the next frame if it is ready, otherwise None. Never waits. Returns None after the end (`ended`).

        Raises InputError for damage, after all frames before the damage have been returned.
        """
        return self._take(0.0)

    def next_frame(self, timeout_s: float) -> Frame | None:
        """Wait for the next frame, and return it. Returns None at the end.

        Raises InputError if the medium is damaged here, or if no frame comes within `timeout_s`.
        """
        deadline = time.monotonic() + timeout_s
        while (frame := self._take(_POLL_S)) is None and not self.ended:
            if time.monotonic() > deadline:
                raise InputError(f"{self.medium}: no frame within {timeout_s:g} s; release frames, or convert it")
        return frame

    def release(self, frame: Frame) -> None:
        """Return a frame's slot to the decoder. Its planes must not be read afterwards."""
        number, slot = frame.slot
        if number == self._number:
            self._child.send({"free": slot})

    def seek(self, time_s: float) -> None:
        """Continue with the frame that is shown at `time_s`, which grows across loops like Frame.time_s.

        Live sources ignore a seek.
        """
        if self._live:
            return
        if self._first is not None:
            self.release(self._first)
            self._first = None
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
        """Allow the decoder to drop pictures that end before `time_s` (as Frame.time_s). A seek cancels this."""
        self._child.send({"skip": time_s, "serial": self._serial})

    def notices(self) -> list[str]:
        """Return the new notices for the user since the last call."""
        fresh, self._notices = self._notices, []
        return fresh

    @property
    def index(self) -> int:
        """Number of the next frame."""
        return self._index - (self._first is not None)

    @property
    def decoder_pid(self) -> int:
        return self._child.process.pid

    def close(self) -> None:
        """Make the decoder end, without waiting for it. Frames that are still held stay readable."""
        self.ended, self._first = True, None
        self._child.close()

    @property
    def info(self) -> MediaInfo:
        assert self._info is not None  # known once the reader is ready
        return self._info

    def _start_child(self, skipped_s: float = 0.0) -> None:
        """Start a decoder, which opens the medium in the background."""
        start = self._start | {"time_s": self._start["time_s"] + skipped_s}
        if self._live:  # a live source's times count from the start of its decoder
            start["offset_s"] = time.monotonic() - self._began_s
        self._child = DecoderLink(self._number, self._arguments | {"start": start})
        self._opened, self._child_began_s, self._restart_at_s = False, time.monotonic(), None

    def _take(self, wait_s: float) -> Frame | None:
        """Return the next frame. Waits at most `wait_s` for each event."""
        frame, self._first = self._first, None
        while frame is None and not self.ended:
            event = self._child.receive(wait_s)
            if event is None:
                self._check_alive()
                break
            frame = self._handle(event)
        return frame

    def _handle(self, event: dict[str, Any]) -> Frame | None:
        """Handle one event of the decoder. Returns a frame if the event is a wanted frame."""
        if "died" in event:
            self._bury(event["died"])
        elif "opened" in event:
            self._take_opened(event["opened"], event["slots"])
        elif "notice" in event:
            self._notices.append(event["notice"])
        elif "changed" in event:
            self._notices.append(f"{event['changed']}; opened again")
            self._replace_child()
        elif "error" in event and not self._opened:
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

    def _take_opened(self, opened: dict[str, Any], slots: int) -> None:
        """Store the properties of the opened medium, and map the ring."""
        pixels = format_from_json(opened["format"])
        if self._info is None:
            names = "frames_per_second", "duration_s", "still", "codec", "frames", "live", "sound"
            self._info = MediaInfo(self._path, pixels, **{name: opened[name] for name in names})
            self._notices += opened["notices"]
        elif self._live:
            self._info = replace(self._info, format=pixels, codec=opened["codec"])
        elif pixels != self.info.format:
            self._failure = f"{self.medium}: has changed since it was opened; open it again"
            return
        self._child.map_ring(slots, pixels)
        self._opened = True

    @property
    def _path(self) -> Path | str:
        return self.medium.name if self._live else Path(self.medium.name)

    def _frame(self, fields: dict[str, Any]) -> Frame:
        self._deaths = 0
        self._start = {
            "serial": self._serial,
            "time_s": fields["time_s"],
            "after": True,
            "offset_s": fields["offset_s"],
        }
        self._lap_s = fields["lap_s"] or self._lap_s
        # Times never decrease, even if a lap is shorter than the container claims.
        time_s = max(fields["offset_s"] + fields["time_s"], self._last_s)
        self._index, self._last_s = self._index + 1 + fields["skipped"], time_s
        planes = self._child.planes(fields["slot"])
        slot = (self._number, fields["slot"])
        times = time_s, fields["duration_s"], fields["decode_s"]
        return Frame(self._index - 1, *times, self.info.format, planes, slot, fields["skipped"])

    def _check_alive(self) -> None:
        """Kill a stopped or stuck decoder; its death then arrives as an event. Raises an earlier failure again."""
        if self._failure is not None:
            raise InputError(self._failure)
        now_s = time.monotonic()
        began_s = self._began_s if self._info is None else self._child_began_s
        if self._restart_at_s is not None:
            if now_s >= self._restart_at_s:
                self._start_child()
        elif self._child.hangs:
            self._child.kill(HUNG)
        elif not self._opened and now_s - began_s > self._opening_s:
            late = f"not opened within {self._opening_s:g} s"
            self._refused(f"{self.medium}: {late}; copy it to a local disk, or convert it")

    def _refused(self, reason: str) -> None:
        """Handle a medium that cannot be opened: an error at first, later a reason for another attempt."""
        if self._info is None:
            raise InputError(reason)
        self._child.kill(reason)
        self._bury(reason)

    def _bury(self, reason: str) -> None:
        """Replace a dead decoder by a decoder that starts after the last frame. After another death there, skip ahead.

        Does not wait for the new decoder. The caller keeps the last frame until a new frame arrives. Attempts for a
        live source never end.
        """
        if self._info is None and reason != HUNG and self._arguments["hwdec"] == PROCESSOR:
            raise InputError(f"{self.medium}: {reason} while opening it; convert or export it again")
        self._deaths += 1
        self._arguments["hwdec"] = PROCESSOR  # a driver of the GPU may be the cause
        if self._deaths > MAX_DEATHS and not self._live:
            self._child.close()
            self._failure = f"{self.medium}: {reason} {MAX_DEATHS} times without a frame; convert the medium"
            self._given_up = True
            return
        is_moving = self._info is not None and not (self._info.still or self._live)
        skipped_s = SKIP_S * (self._deaths - 1) if is_moving else 0.0
        when = f"after {time.monotonic() - self._began_s:.1f} s"
        self._notices.append(f"{self.medium}: {reason} {when}; restarted{_skipped(skipped_s)}")
        self._replace_child(skipped_s)

    def _replace_child(self, skipped_s: float = 0.0) -> None:
        """Start another decoder. For a live source that keeps failing, the pauses grow."""
        self._child.close()
        self._number, self._opened, now_s = self._number + 1, False, time.monotonic()
        if not self._live:
            self._start_child(skipped_s)
            return
        self._losses = 0 if now_s - self._child_began_s > STEADY_S else self._losses + 1
        self._restart_at_s = now_s + LIVE_RETRY_S[min(self._losses, len(LIVE_RETRY_S) - 1)]


def _skipped(seconds: float) -> str:
    return f", skipping {seconds:g} s" if seconds else ""
