"""Sound in step with the picture: samples from a child process, an output, and the clock of the audible samples.

While samples are audible, their clock determines media time and the pictures follow. Before that, the samples follow
the picture's clock: late samples are dropped, and early samples wait.
"""

import json
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from counterlight.media.decoding.child import Letters, end_child, start_child
from counterlight.media.decoding.sound_blocks import CHANNELS, HEADER, NO_SOUND, RATE, Samples
from counterlight.media.medium import Medium

AHEAD = RATE  # samples that are kept ready: one second
MISSING = "no sound: the package sounddevice is missing; install it with: pip install sounddevice"

Pull = Callable[[int, float], Samples]


class Sink(Protocol):
    """An audio output. It calls `pull(count, heard_at_s)` for stereo pairs that are audible from that clock time on."""

    def start(self, pull: Pull) -> None: ...
    def close(self) -> None: ...


class AudioOutput:
    """The player's sound: volume (in percent, cubed as in mpv), mute, and the track that is heard."""

    def __init__(self, sink: Sink, clock: Callable[[], float] = time.monotonic) -> None:
        self.volume, self.mute = 100.0, False
        self._sink, self._clock = sink, clock
        self._track: Track | None = None
        sink.start(self.pull)

    def open(self, medium: Medium | str) -> "Track":
        """Return the sound of a file, for `hear`. Raises InputError if no process can be started."""
        return Track(Medium.of(medium), self._clock)

    def hear(self, track: "Track") -> None:
        """Play this track instead of the previous track."""
        self._track = track

    def pull(self, count: int, heard_at_s: float) -> Samples:
        track = self._track
        pairs = np.zeros((count, CHANNELS), np.float32) if track is None else track.pull(count, heard_at_s)
        gain = 0.0 if self.mute else (self.volume / 100) ** 3
        loud: Samples = np.clip(pairs * np.float32(gain), -1, 1)
        return loud

    def close(self) -> None:
        self._sink.close()
        self._track = None


class Track:
    """The sound of one medium. Times are in seconds of the medium; clock times are times of `clock`."""

    def __init__(self, medium: Medium, clock: Callable[[], float]) -> None:
        self._clock, self._lock = clock, threading.Condition()
        self._blocks: deque[Samples] = deque()
        self._ready = self._serial = 0
        self._next_s = 0.0  # time of the first ready sample
        self._speed = 1.0
        self._plan: tuple[float, float] | None = None  # (clock time, media time) of the planned sound; None for silence
        self._heard: tuple[float, float] | None = None  # (clock time, media time) of audible samples
        self._heard_until_s = 0.0
        self._child = start_child("counterlight.media.decoding.audio_decoder", subprocess.DEVNULL)
        self._letters = Letters(self._child)
        self._letters.send(json.dumps(asdict(medium)).encode())
        self._closed = False
        self._listener = threading.Thread(target=self._listen, name="audio", daemon=True)
        self._listener.start()
        self.seek(0.0, 1.0)

    @property
    def ready(self) -> int:
        """Number of samples that are ready to play."""
        return self._ready

    def kill(self) -> None:
        """End the decoder; samples that are ready are still played."""
        self._child.kill()

    def seek(self, time_s: float, speed: float) -> None:
        """Stop the sound, and prepare the samples from `time_s` on."""
        with self._lock:
            self._serial += 1
            self._blocks.clear()
            self._ready, self._next_s, self._speed = 0, time_s, speed
            self._plan = self._heard = None
            self._lock.notify()
        order = {"serial": self._serial, "time_s": time_s, "speed": speed}
        self._letters.send(json.dumps(order).encode())

    def play(self, time_s: float, at_s: float) -> None:
        """Play `time_s` at clock time `at_s`, and continue from there."""
        with self._lock:
            self._plan, self._heard = (at_s, time_s), None

    def pause(self) -> None:
        with self._lock:
            self._plan = self._heard = None

    def time_s(self) -> float | None:
        """Return the media time that is audible now, None during silence."""
        self._letters.flush()
        with self._lock:
            now_s = self._clock()
            if self._heard is None or now_s > self._heard_until_s:
                return None
            at_s, time_s = self._heard
            return time_s + (now_s - at_s) * self._speed

    def pull(self, count: int, heard_at_s: float) -> Samples:
        """Return the next stereo pairs for the output, (count, 2) float32. Zero where no samples are ready."""
        out = np.zeros((count, CHANNELS), np.float32)
        with self._lock:
            if self._plan is None:
                return out
            at_s, time_s = self._plan
            ahead = 0
            if self._heard is None:
                late = round((time_s + (heard_at_s - at_s) * self._speed - self._next_s) / self._speed * RATE)
                self._take(max(late, 0))
                ahead = min(max(-late, 0), count)
            begin_s = self._next_s
            pairs = self._take(count - ahead)
            out[ahead : ahead + len(pairs)] = pairs
            self._lock.notify()
            if len(pairs):
                self._plan = self._heard = heard_at_s + ahead / RATE, begin_s
                self._heard_until_s = heard_at_s + 2 * count / RATE  # the output must ask again before this time
            else:
                self._heard = None
        return out

    def close(self) -> None:
        with self._lock:
            self._closed, self._plan, self._heard = True, None, None
            self._lock.notify()
        self.kill()
        end_child(self._child, self._listener.join)

    def _take(self, count: int) -> Samples:
        """Remove and return up to `count` ready samples."""
        taken: list[Samples] = []
        while count and self._blocks:
            block = self._blocks.popleft()
            if len(block) > count:
                self._blocks.appendleft(block[count:])
                block = block[:count]
            taken.append(block)
            count -= len(block)
        pairs = np.concatenate(taken) if taken else np.zeros((0, CHANNELS), np.float32)
        self._ready -= len(pairs)
        self._next_s += len(pairs) / RATE * self._speed
        return pairs

    def _listen(self) -> None:
        stream: Any = self._child.stdout
        try:
            while len(head := stream.read(HEADER.size)) == HEADER.size:
                serial, count = HEADER.unpack(head)
                data = stream.read(count * CHANNELS * 4)
                if serial == NO_SOUND or len(data) < count * CHANNELS * 4:
                    continue
                self._put(serial, np.frombuffer(data, "<f4").reshape(-1, CHANNELS))
        except (OSError, ValueError):
            pass  # the stream was closed

    def _put(self, serial: int, block: NDArray[np.float32]) -> None:
        with self._lock:
            self._lock.wait_for(lambda: self._closed or serial != self._serial or self._ready < AHEAD)
            if serial == self._serial and len(block):
                self._blocks.append(block)
                self._ready += len(block)


class DeviceSink:
    """The default output device, through PortAudio."""

    def __init__(self) -> None:
        import sounddevice

        self._sounddevice: Any = sounddevice
        self._stream: Any = None

    def start(self, pull: Pull) -> None:
        def fill(out: Any, count: int, times: Any, status: object) -> None:
            latency_s = times.outputBufferDacTime - times.currentTime
            out[:] = pull(count, time.monotonic() + (latency_s if latency_s > 0 else self._stream.latency))

        self._stream = self._sounddevice.OutputStream(
            samplerate=RATE, channels=CHANNELS, dtype="float32", latency="high", callback=fill
        )
        self._stream.start()

    def close(self) -> None:
        self._stream.close()


def open_audio(volume: float, *, mute: bool) -> tuple[AudioOutput | None, str | None]:
    """Open the default device. Without a device, returns None and a line with the reason."""
    try:
        output = AudioOutput(DeviceSink())
        output.volume, output.mute = volume, mute
        return output, None
    except ImportError:
        return None, MISSING
    except Exception as error:  # errors of PortAudio; also OSError if its library is missing
        return None, f"no sound: {' '.join(str(error).split())}; pictures follow the system clock"
