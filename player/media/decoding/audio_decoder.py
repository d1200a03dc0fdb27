"""The audio decoder process: `python -m counterlight.media.decoding.audio_decoder`, started only by media/audio.py.

Reads the medium from stdin, then orders as JSON lines {"serial": n, "time_s": t, "speed": v}. Writes blocks to stdout:
HEADER (serial, samples), then that many stereo pairs of float32 at RATE. The first pair is at `time_s` of the medium,
and `speed` media seconds last one second. A block of 0 samples marks the end; serial −1 means that there is no sound.
"""

import json
import os
import signal
import sys
import threading
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import IO

import av
import numpy as np

from counterlight.errors import InputError
from counterlight.media.decoding.child import limit_memory, private_stdout
from counterlight.media.decoding.opening import first_picture_s, log_natively, open_file
from counterlight.media.decoding.sound_blocks import CHANNELS, HEADER, NO_SOUND, RATE, Samples
from counterlight.media.medium import Medium


class Orders:
    """The latest order on stdin. The process quits when the parent closes its pipe."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self._changed = stream, threading.Condition()
        self._order: dict[str, float] | None = None
        threading.Thread(target=self._listen, daemon=True).start()

    @property
    def waiting(self) -> bool:
        return self._order is not None

    def wait(self) -> dict[str, float]:
        with self._changed:
            self._changed.wait_for(lambda: self._order is not None)
            order, self._order = self._order, None
            assert order is not None
            return order

    def _listen(self) -> None:
        for line in self._stream:
            with self._changed:
                self._order = json.loads(line)
                self._changed.notify()
        os._exit(0)


def decoded(medium: Medium, time_s: float, speed: float) -> Iterator[Samples]:
    """Yield stereo pairs, (samples, 2), from `time_s` after the first picture on. Yields none if there is no sound."""
    with open_file(medium, Path(medium.name)) as container:
        if not container.streams.audio:
            return
        stream = container.streams.audio[0]
        origin_s = first_picture_s(container)
        if time_s > 0:
            container.seek(int((time_s + origin_s) * av.time_base))
        resampler = av.AudioResampler(format="flt", layout="stereo", rate=RATE)
        tempo, lacking = _tempo(speed), None
        for frame in chain(container.decode(stream), [None]):
            for pairs in (_pairs(piece) for piece in resampler.resample(frame)):
                if lacking is None:  # samples missing before the first; negative: too early
                    assert frame is not None
                    lacking = round(((frame.time or 0.0) - origin_s - time_s) * RATE)
                    if lacking > 0:
                        yield from tempo(np.zeros((lacking, CHANNELS), np.float32))
                        lacking = 0
                early = min(-lacking, len(pairs))
                lacking += early
                if early < len(pairs):
                    yield from tempo(pairs[early:])
        yield from tempo(None)


class _Tempo:
    """FFmpeg's filter atempo: changes the speed and keeps the pitch."""

    def __init__(self, speed: float) -> None:
        self._graph = av.filter.Graph()
        nodes = [self._graph.add_abuffer(sample_rate=RATE, format="flt", layout="stereo")]
        while speed < 0.5:  # the filter accepts no smaller factor
            nodes.append(self._graph.add("atempo", "0.5"))
            speed /= 0.5
        nodes += [self._graph.add("atempo", f"{speed:.9g}"), self._graph.add("abuffersink")]
        self._graph.link_nodes(*nodes).configure()

    def __call__(self, pairs: Samples | None) -> Iterator[Samples]:
        frame = None
        if pairs is not None:
            frame = av.AudioFrame.from_ndarray(
                np.ascontiguousarray(pairs.reshape(1, -1)), format="flt", layout="stereo"
            )
            frame.sample_rate = RATE
        self._graph.push(frame)
        while True:
            try:
                piece = self._graph.pull()
            except (av.BlockingIOError, av.EOFError):
                return
            assert isinstance(piece, av.AudioFrame)
            yield _pairs(piece)


def _tempo(speed: float) -> "_Tempo | _Same":
    return _Same() if speed == 1 else _Tempo(speed)


class _Same:
    def __call__(self, pairs: Samples | None) -> Iterator[Samples]:
        if pairs is not None:
            yield pairs


def _pairs(frame: av.AudioFrame) -> Samples:
    return np.asarray(frame.to_ndarray(), np.float32).reshape(-1, CHANNELS)


def main(medium: Medium, orders: Orders, out: IO[bytes]) -> None:
    """Follow orders until the parent ends. Undecodable parts are silent."""
    while True:
        order = orders.wait()
        serial, sent = int(order["serial"]), 0
        try:
            for pairs in decoded(medium, order["time_s"], order["speed"]):
                if orders.waiting:
                    break
                out.write(HEADER.pack(serial, len(pairs)) + pairs.tobytes())
                sent += len(pairs)
        except (av.FFmpegError, InputError, OSError, ValueError):
            pass  # the decoder of the picture reports what is wrong with the file
        if not orders.waiting:
            out.write(HEADER.pack(serial if sent or order["time_s"] else NO_SOUND, 0))
        out.flush()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_memory()
    log_natively(av.logging.PANIC)
    try:
        medium = Medium(**json.loads(sys.stdin.buffer.readline()))
        main(medium, Orders(sys.stdin.buffer), private_stdout())
    finally:
        os._exit(1)  # the parent has ended
