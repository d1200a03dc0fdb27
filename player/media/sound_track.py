"""Copies the sound of a medium unchanged into a written film. A separate process reads the packets."""

import json
import select
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import av
from av.container import OutputContainer

from counterlight.errors import InputError
from counterlight.media.decoding.child import start_child
from counterlight.media.decoding.opening import open_file
from counterlight.media.medium import Medium

PATIENCE_S = 30.0  # longest time without a sign from a copier


@contextmanager
def copied_sound(medium: Medium, start_s: float, tell: Callable[[str], None]) -> Iterator[Path | None]:
    """Yield a temporary file with a medium's sound from `start_s` on, or None if there is no sound.

    tell : function that takes a line with the reason why existing sound cannot be copied.
    """
    with tempfile.TemporaryDirectory(prefix="counterlight-") as folder:
        path = Path(folder) / "sound.nut"
        found = _copied({"medium": asdict(medium), "output": str(path), "start_s": start_s})
        if found["reason"]:
            tell(f"{medium}: its sound cannot be copied ({found['reason']}); the output has none")
        yield path if found["copied"] else None


def _copied(order: dict[str, Any]) -> dict[str, Any]:
    child = start_child("counterlight.media.decoding.sound_copier", subprocess.DEVNULL)
    assert child.stdin is not None
    assert child.stdout is not None
    try:
        with suppress(BrokenPipeError):
            child.stdin.write(json.dumps(order).encode() + b"\n")
            child.stdin.flush()
        line = b"\n"
        while line == b"\n":
            heard, _, _ = select.select([child.stdout], [], [], PATIENCE_S)
            line = child.stdout.readline() if heard else b""
    finally:
        child.kill()
        child.stdin.close()
        child.stdout.close()
        child.wait()
    found: dict[str, Any] = json.loads(line) if line else {"copied": False, "reason": "it cannot be read"}
    return found


class SoundTrack:
    """Writes sound into a film alongside its pictures.

    Raises InputError if the container cannot hold this kind of sound.

    path : file from copied_sound.
    film : the container. Its pictures' times count from the first picture that is written.
    """

    def __init__(self, path: Path, film: OutputContainer) -> None:
        self._film = film
        self._source = open_file(Medium(str(path)), path)
        track = self._source.streams.audio[0]
        try:
            self._stream = film.add_stream_from_template(track)
        except (ValueError, av.FFmpegError):
            self._source.close()
            name = track.codec_context.name
            raise InputError(f"{film.format.name} holds no {name} sound; the output has none, .mkv takes it") from None
        self._packets = (packet for packet in self._source.demux(track) if packet.size)
        self._waiting = next(self._packets, None)

    def follow(self, first_s: float, until_s: float) -> None:
        """Write the packets from `first_s`, the first picture's time, to before `until_s`. Times must grow."""
        while self._waiting is not None and self._time(self._waiting) < until_s:
            packet, self._waiting = self._waiting, next(self._packets, None)
            assert packet.pts is not None
            if self._time(packet) >= first_s:
                packet.pts -= round(Fraction(first_s) / packet.time_base)
                packet.dts = packet.pts
                packet.stream = self._stream
                self._film.mux(packet)

    def _time(self, packet: "av.Packet[Any]") -> Fraction:
        return (packet.pts or 0) * packet.time_base

    def __enter__(self) -> "SoundTrack":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._source.close()
