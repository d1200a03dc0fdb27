"""The process that copies sound: `python -m counterlight.media.decoding.sound_copier`. media/sound_track.py starts it.

Reads one JSON line {"medium": …, "output": path, "start_s": t} from stdin. Copies the packets of the medium's first
sound track unchanged. Writes empty lines to stdout as heartbeats, then {"copied": whether there is sound, "reason":
error}.
"""

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import av
from av.audio.stream import AudioStream
from av.container import InputContainer

from counterlight.errors import InputError
from counterlight.media.decoding.child import limit_memory, private_stdout
from counterlight.media.decoding.opening import first_picture_s, log_natively, open_file, reason
from counterlight.media.medium import Medium

SIGN_EVERY_S = 1.0


def copy(medium: Medium, output: Path, start_s: float, alive: Callable[[], None]) -> bool:
    """Write the track to `output`, in NUT, which holds every codec with its own times. Returns False without a track.

    Times count from the medium's first picture. Packets that end before `start_s` are omitted.
    Raises FFmpeg's errors.

    alive : called with each packet.
    """
    with open_file(medium, Path(medium.name)) as source:
        if not source.streams.audio:
            return False
        track, origin_s = source.streams.audio[0], first_picture_s(source)
        if start_s > 0:
            source.seek(int((start_s + origin_s) * av.time_base))
        with av.open(f"file:{output}", "w", format="nut") as sink:
            stream = sink.add_stream_from_template(track)
            for packet in _timed(source, track, origin_s, start_s):
                packet.stream = stream
                sink.mux(packet)
                alive()
    return True


def _timed(
    source: InputContainer, track: AudioStream, origin_s: float, start_s: float
) -> "Iterator[av.Packet[AudioStream]]":
    """Yield the packets from `start_s` on, timed from the first picture. Not every container holds negative times."""
    shift = round(origin_s / track.time_base) if track.time_base else 0
    for packet in source.demux(track):
        if packet.pts is None or packet.dts is None or not packet.size:
            continue
        packet.pts, packet.dts = packet.pts - shift, packet.dts - shift
        if packet.dts >= 0 and (packet.pts + (packet.duration or 0)) * packet.time_base > start_s:
            yield packet


class _Life:
    """Sends an empty line to the parent every SIGN_EVERY_S."""

    def __init__(self, pipe: IO[bytes]) -> None:
        self._pipe, self._signed_s = pipe, time.monotonic()

    def __call__(self) -> None:
        if time.monotonic() - self._signed_s > SIGN_EVERY_S:
            self._signed_s = time.monotonic()
            self._pipe.write(b"\n")
            self._pipe.flush()


def main() -> None:
    answer = private_stdout()
    request = json.loads(sys.stdin.buffer.readline())
    threading.Thread(target=_end_with_parent, daemon=True).start()
    medium, output = Medium(**request["medium"]), Path(request["output"])
    try:
        found = {"copied": copy(medium, output, request["start_s"], _Life(answer)), "reason": ""}
    except (av.FFmpegError, InputError, OSError, ValueError) as error:
        found = {"copied": False, "reason": reason(error)}
    answer.write(json.dumps(found).encode() + b"\n")
    answer.flush()


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(1)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_memory()
    log_natively(av.logging.PANIC)
    main()
    os._exit(0)
