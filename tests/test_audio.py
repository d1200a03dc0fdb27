"""Sound in step with the picture: a real clip and its two decoders; the output is a fake that follows a clock.

Samples encode their position: sample n of the medium is n / SAMPLES, a ramp over its whole length.
"""

import sys
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from counterlight.media.audio import MISSING, AudioOutput, Pull, open_audio
from counterlight.media.decoding.audio_decoder import RATE, decoded
from counterlight.media.medium import Medium
from counterlight.media.video import MediaReader
from counterlight.show.hearing import Hearing
from counterlight.show.playback import Playback
from tests.ffmpeg_frames import ffmpeg_frame
from tests.stage import Clock, Reader, Stage

SECONDS, FPS = 8, 25
SAMPLES = SECONDS * RATE
BLOCK, LATENCY_S = 480, 0.1
HEARD_S = 2 / RATE  # rounding to samples, twice


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sound") / "clip.mkv"
    grey, neutral = np.full((32, 48), 100, np.uint8), np.full((16, 24), 128, np.uint8)
    ramp = np.arange(SAMPLES, dtype=np.float32) / SAMPLES
    with av.open(str(path), "w") as container:
        picture: Any = container.add_stream("ffv1", rate=FPS)
        picture.height, picture.width, picture.pix_fmt = 32, 48, "yuv420p"
        sound: Any = container.add_stream("pcm_f32le", rate=RATE, layout="stereo")
        for i in range(SECONDS * FPS):
            frame = ffmpeg_frame((grey, neutral, neutral), "yuv420p")
            frame.pts, frame.time_base = i, Fraction(1, FPS)
            container.mux(picture.encode(frame))
            part = ramp[i * RATE // FPS : (i + 1) * RATE // FPS].repeat(2)[None]
            piece = av.AudioFrame.from_ndarray(part, format="flt", layout="stereo")
            piece.sample_rate, piece.pts, piece.time_base = RATE, i * RATE // FPS, Fraction(1, RATE)
            container.mux(sound.encode(piece))
        container.mux(picture.encode(None))
        container.mux(sound.encode(None))
    return path


class ClockedSink:
    """Requests a block for every BLOCK samples of its own clock, which may run faster than the system's clock."""

    def __init__(self, clock: Clock, rate: float = 1.0) -> None:
        self._clock, self._began_s, self._rate, self._asked = clock, clock.now, rate, 0
        self.heard: list[tuple[float, float, float]] = []  # clock time, first and last sample of a block

    def start(self, pull: Pull) -> None:
        self._pull = pull

    def close(self) -> None: ...

    def run(self) -> None:
        while self._asked * BLOCK / RATE < (self._clock.now - self._began_s) * self._rate:
            at_s = self._began_s + self._asked * BLOCK / RATE / self._rate + LATENCY_S
            pairs = self._pull(BLOCK, at_s)
            self.heard.append((at_s, float(pairs[0, 0]), float(pairs[-1, 0])))
            self._asked += 1


class Show:
    """Clip, its sound, and a clock that waits for both decoders."""

    def __init__(self, clip: Path, *, rate: float = 1.0, loop: bool = False) -> None:
        self.clock = Clock()
        self.sink = ClockedSink(self.clock, rate)
        self.output = AudioOutput(self.sink, self.clock)
        self.track = self.output.open(str(clip))
        self.output.hear(self.track)
        self.reader = MediaReader.open(clip, loop=loop)
        self.playback = Playback(self.reader, self.clock, loop=loop, seamless=loop, sound=self.track)
        self.shown: list[tuple[float, float]] = []  # clock time, time of the frame
        self.settle()

    def settle(self) -> None:
        """Wait until samples are ready."""
        until = time.monotonic() + 30
        while not self.track.ready and time.monotonic() < until:
            time.sleep(0.01)
        assert self.track.ready

    def run(self, seconds: float) -> None:
        end = self.clock.now + seconds
        while self.clock.now < end:
            self.sink.run()
            if (frame := self.playback.due()) is not None:
                self.shown.append((self.clock.now, frame.time_s))
                self.reader.release(frame)
            time.sleep(0.002)  # time for the decoders
            self.clock.now += 0.005

    def offset_s(self) -> float:
        """Returns the media time that is heard now, less the present media time."""
        at_s, first, _ = self.sink.heard[-1]
        assert first > 0, "silence"
        now_s = self.playback.media_s
        assert now_s is not None
        heard_s = first * SECONDS + (self.clock.now - at_s) * self.playback.speed
        return heard_s - now_s % SECONDS

    def close(self) -> None:
        self.playback.close()
        self.output.close()


@pytest.mark.parametrize("time_s", [0.0, 1.2345, 7.9])
def test_samples_begin_exactly_where_asked(clip: Path, time_s: float) -> None:
    pairs = np.concatenate(list(decoded(Medium(str(clip)), time_s, 1.0)))
    np.testing.assert_allclose(pairs[:, 1], np.arange(round(time_s * RATE), SAMPLES) / SAMPLES, atol=1e-7)


@pytest.mark.parametrize("speed", [0.25, 2.0])
def test_speed_changes_how_many_samples_there_are(clip: Path, speed: float) -> None:
    count = sum(len(pairs) for pairs in decoded(Medium(str(clip)), 4.0, speed))
    assert count == pytest.approx(SAMPLES / 2 / speed, rel=0.02)  # atempo works in windows of samples


def test_pictures_follow_the_sound_even_if_its_clock_runs_fast(clip: Path) -> None:
    """With a sound card 2 % fast, the system clock would be 80 ms behind after 4 s, which is two frames."""
    show = Show(clip, rate=1.02)
    show.run(4.0)
    assert abs(show.offset_s()) <= 1e-3 + 0.02 * BLOCK / RATE
    clock_s, time_s = show.shown[-1]
    begun_s, first_s = show.shown[0]
    assert (time_s - first_s) - (clock_s - begun_s) > 0.04
    show.close()


def test_what_is_heard_belongs_to_what_is_shown_after_pause_seek_and_laps(clip: Path) -> None:
    show = Show(clip, loop=True)
    show.run(1.0)
    assert abs(show.offset_s()) <= HEARD_S
    show.playback.paused = True
    show.run(0.5)
    assert show.sink.heard[-1][1:] == (0.0, 0.0)
    show.playback.paused = False
    show.run(0.5)
    assert abs(show.offset_s()) <= HEARD_S
    show.playback.seek(6.0)
    show.settle()
    show.run(1.0)
    assert abs(show.offset_s()) <= HEARD_S
    assert show.shown[-1][1] == pytest.approx(6.9, abs=0.1)
    show.run(1.1)
    show.settle()
    show.run(0.5)  # into the second lap
    assert abs(show.offset_s()) <= HEARD_S
    assert show.playback.position_s < 2
    show.close()


def test_speed_keeps_sound_and_picture_together(clip: Path) -> None:
    show = Show(clip)
    show.run(0.5)
    show.playback.speed = 2.0
    show.settle()
    show.run(1.0)
    assert abs(show.offset_s()) <= 0.06  # atempo moves windows by up to this much to fit
    assert show.shown[-1][1] == pytest.approx(2.5, abs=0.15)
    show.close()


def test_volume_is_cubed_and_mute_is_silence(clip: Path) -> None:
    show = Show(clip)
    show.run(1.0)
    loud = show.sink.heard[-1][1]
    show.output.volume = 50
    show.run(0.05)
    assert show.sink.heard[-1][1] == pytest.approx(loud / 8, rel=0.1)  # the sound is now 5 % further on the ramp
    show.output.mute = True
    show.run(0.05)
    assert show.sink.heard[-1][1:] == (0.0, 0.0)
    show.close()


def test_a_dead_sound_decoder_leaves_pictures_to_the_system_clock(clip: Path) -> None:
    show = Show(clip)
    show.run(0.5)
    show.track.kill()
    show.run(2.5)
    assert show.track.time_s() is None
    assert show.shown[-1][1] == pytest.approx(2.96, abs=0.1)
    show.close()


def test_why_there_is_no_sound_is_reported_once(clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    assert open_audio(100, mute=False) == (None, MISSING)
    readers = Reader("a", count=3), Reader("b", count=3), Reader("c", count=3)
    for reader in readers[1:]:
        reader.info.sound = True
    stage = Stage(*readers, silence=MISSING)
    stage.advance(0.1)
    assert stage.session.stats.notices == []
    stage.advance(0.5)
    assert stage.session.stats.notices == [MISSING]


def test_without_a_device_one_line_says_so() -> None:
    output, line = open_audio(100, mute=False)
    if output is not None:  # a machine that has a device
        output.close()
        return
    assert line is not None
    assert line.startswith("no sound: ")
    assert "\n" not in line


def test_the_next_mediums_sound_is_prepared_while_the_present_one_is_heard(clip: Path) -> None:
    show = Show(clip)
    hearing = Hearing(show.output, None, pytest.fail)
    hearing.prepare(show.reader.info, Medium(str(clip)))
    show.run(0.5)
    assert show.sink.heard[-1][1] == pytest.approx(0.5 / SECONDS, rel=0.2)
    track = hearing.track(show.reader.info, Medium(str(clip)))
    assert track is not None
    track.play(0.0, show.clock.now)
    while track.ready < BLOCK:
        time.sleep(0.001)
    pairs = show.output.pull(BLOCK, show.clock.now)
    np.testing.assert_allclose(pairs[:, 0], np.arange(BLOCK) / SAMPLES, atol=1e-6)  # float32 of a ramp to 1
    track.close()
    show.close()
