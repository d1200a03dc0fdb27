"""A real clip and decoder against a simulated clock: frames shown when rendering is slow."""

import time
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import numpy as np
import pytest

from counterlight.media.medium import Border, Medium
from counterlight.media.video import MediaReader
from counterlight.show import playback as playbacks
from counterlight.show.beginning import Playing
from counterlight.show.media import Media
from counterlight.show.playback import Playback
from counterlight.show.playlist import Playlist
from counterlight.show.session import Session
from counterlight.show.show import Show
from tests.ffmpeg_frames import ffmpeg_frame
from tests.stage import Clock, Screen

RATE, FRAMES = 25, 250
FRAME_S = 1 / RATE
DECODER_S = 0.02  # real seconds per millisecond that the clock waits for the decoder


class SlowScreen(Screen):
    """A display and renderer that take `rendering_s` of the clock's time per frame."""

    def __init__(self, clock: Clock, rendering_s: float) -> None:
        super().__init__()
        self._clock, self._rendering_s = clock, rendering_s
        self.asked: list[float] = []

    def poll(self, timeout_s: float) -> list[str]:
        self._clock.now += max(timeout_s, 1e-4)  # a smaller step can vanish in the clock's rounding
        if timeout_s <= playbacks.DECODER_WAIT_S:
            time.sleep(DECODER_S)
        return []

    def render(self, view: str, **options: Any) -> None:
        super().render(view, **options)
        self._clock.now += self._rendering_s


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write ten seconds at 25 frames per second."""
    path = tmp_path_factory.mktemp("clip") / "clip.mkv"
    grey, neutral = np.full((32, 48), 100, np.uint8), np.full((16, 24), 128, np.uint8)
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("ffv1", rate=RATE)
        stream.height, stream.width, stream.pix_fmt = 32, 48, "yuv420p"
        for i in range(FRAMES):
            frame = ffmpeg_frame((grey, neutral, neutral), "yuv420p")
            frame.pts, frame.time_base = i, Fraction(1, RATE)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


class Waiting(Media):
    """Opens media immediately, because no time passes on the simulated clock while a medium opens."""

    def begin(self, medium: Medium, *, loop: bool) -> MediaReader:
        return MediaReader.open(medium, loop=loop)


def played(clip: Path, rendering_s: float, limit: int | None = None, **setup: Any) -> tuple[Session, SlowScreen]:
    clock = Clock()
    screen = SlowScreen(clock, rendering_s)
    session = Session(
        Playlist([str(clip)]),
        Waiting(Border()),
        screen,  # type: ignore[arg-type]
        screen,
        SimpleNamespace(drifted=None, appraise=None, psnr=None, stand=lambda viewpoint: None, unlit=lambda *_: None),  # type: ignore[arg-type]  # what the session calls
        **setup,
        clock=clock,
    )
    Show(session).run(limit)
    return session, screen


Play = Callable[[float], tuple[Session, SlowScreen]]


@pytest.fixture(scope="module")
def whole(clip: Path) -> Play:
    """Return a function that plays the whole clip at a rendering time, once for all tests."""
    return cache(lambda rendering_s: played(clip, rendering_s))


@pytest.fixture(params=[0.07, 0.3, 0.5, 1.1])
def rendering_s(request: pytest.FixtureRequest) -> float:
    """Return rendering times of 2 to 28 frame times. The decoder's ring holds 8 frames."""
    return float(request.param)


def test_what_is_shown_is_never_later_than_a_frame_time_and_a_rendering(clip: Path, rendering_s: float) -> None:
    longest_s = rendering_s + FRAME_S  # one rendering plus the longest wait for the next frame
    session, screen = played(clip, rendering_s, limit=int(FRAMES / RATE / longest_s) - 1)
    assert session.stats.percentile_ms("late", 100) <= 1000 * longest_s + 5  # waits are a few milliseconds
    assert session.stats.stalled_s == 0
    assert len(screen.uploaded) > 1


def test_the_end_comes_when_it_should_and_its_last_picture_is_shown(whole: Play, rendering_s: float) -> None:
    session, screen = whole(rendering_s)
    assert screen.uploaded[-1] == FRAMES - 1
    assert session.stats.frames >= FRAMES / RATE / (rendering_s + 2 * FRAME_S)


def test_every_picture_is_either_shown_or_counted_as_dropped(whole: Play, rendering_s: float) -> None:
    session, screen = whole(rendering_s)
    assert len(screen.uploaded) + session.stats.dropped == screen.uploaded[-1] + 1
    assert screen.uploaded == sorted(set(screen.uploaded))


def test_a_fast_renderer_drops_nothing(whole: Play) -> None:
    session, screen = whole(0.03)
    assert screen.uploaded == list(range(FRAMES))
    assert session.stats.dropped == 0
    assert session.stats.percentile_ms("late", 100) < 1000 * (0.03 + FRAME_S)


@pytest.mark.parametrize(("rendering_s", "every"), [(0.03, 1), (0.045, 2), (0.07, 2), (0.105, 3), (0.3, 8)])
def test_a_slow_renderer_shows_every_nth_frame(whole: Play, rendering_s: float, every: int) -> None:
    """After a few seconds, the intervals are equal. The last frame is shown, whatever its number."""
    session, screen = whole(rendering_s)
    settled = [number for number in screen.uploaded if number > FRAMES / 2][:-1]
    assert set(np.diff(settled)) == {every}
    assert session.every == every


def test_laps_and_speeds_are_in_time_too(clip: Path) -> None:
    session, screen = played(clip, 0.6, limit=30, playing=Playing(loop_file=True, speed=2.0))
    assert session.stats.percentile_ms("late", 100) <= 1000 * (0.6 + FRAME_S) + 5
    assert screen.uploaded[-1] > 3 * FRAMES  # 30 renderings of 0.6 s at twice the speed: 36 s


class SlowDecoder:
    """A reader at 25 frames per second that delivers one frame whenever its clock has advanced by `decode_s`."""

    def __init__(self, reader: MediaReader, clock: Clock, decode_s: float) -> None:
        self._reader, self._clock, self._decode_s, self._next_s = reader, clock, decode_s, clock.now

    def __getattr__(self, name: str) -> Any:
        return getattr(self._reader, name)

    def skip(self, time_s: float) -> None: ...

    def poll(self) -> Any:
        if self._clock.now < self._next_s:
            return None
        self._next_s = self._clock.now + self._decode_s
        return self._reader.next_frame(timeout_s=60)


def test_time_waits_for_a_decoder_that_cannot_keep_up(clip: Path) -> None:
    """Decoding takes 80 ms per 40 ms frame.

    Playback runs at half speed, and no frame is late by more than the tolerance.
    """
    clock, late_s, began_s = Clock(), [], 100.0
    with MediaReader.open(clip) as reader:
        playback = Playback(SlowDecoder(reader, clock, 2 * FRAME_S - 1e-3), clock)  # the clock advances by 5 ms
        while not playback.finished:
            frame = playback.due()
            if frame is not None:
                due_s = playback.due_at(frame)
                assert due_s is not None
                late_s.append(clock.now - due_s)
                reader.release(frame)
            clock.now += 0.005
    assert max(late_s) <= FRAME_S + 0.005
    assert clock.now - began_s == pytest.approx(2 * FRAMES / RATE, rel=0.05)
    assert playback.stalled_s == pytest.approx(FRAMES / RATE, rel=0.05)
    assert len(late_s) > FRAMES / 2
