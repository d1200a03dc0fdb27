"""What an unattended show rests on: memory and OpenGL objects that do not grow, a decoder that may crash or stop."""

import gc
import os
import signal
import time
from pathlib import Path

import moderngl
import numpy as np
import pytest

from counterlight.gl.renderer import GlRenderer
from counterlight.media.video import Frame, MediaReader
from counterlight.unattended.heartbeat import rss_bytes
from tests.gl_objects import live_objects
from tests.rooms import random_room
from tests.test_memory import two_seconds  # noqa: F401 (a fixture)

WARM_UP, FRAMES = 1_000, 10_000
MOST_GROWTH = 10 << 20  # the bound
HELD_S, BACK_S = 1.0, 5.0  # the bounds: the loop that shows pictures goes on, the decoder is back
PATIENCE_S = 60.0


def test_ten_thousand_frames_leave_memory_and_objects_as_they_were(
    gl_context: moderngl.Context,
    rng: np.random.Generator,
    two_seconds: Path,  # noqa: F811
) -> None:
    """Whole frames: decoded, uploaded, rendered, and read back as a headless player does, the decoder's memory too."""
    renderer = GlRenderer(gl_context, random_room(rng, far=True))
    with MediaReader.open(two_seconds, loop=True) as reader:
        renderer.open(reader.info.format)
        processes = ("self", reader.decoder_pid)
        before, objects, rendered = [0, 0], {}, 0
        for index in range(WARM_UP + FRAMES):
            if index == WARM_UP:
                gc.collect()
                before, objects = [rss_bytes(pid) or 0 for pid in processes], live_objects()
            frame = reader.next_frame(PATIENCE_S)
            assert frame is not None
            renderer.upload(frame)
            reader.release(frame)
            renderer.render("projector", compensate=True, frame=index)
            rendered += renderer.encoded().any()
        gc.collect()
        growth = [(rss_bytes(pid) or 0) - start for pid, start in zip(processes, before, strict=True)]
        assert live_objects() == objects
        assert frame.index == WARM_UP + FRAMES - 1
        assert processes[1] == reader.decoder_pid  # one decoder all the time
    renderer.release()
    assert rendered > 0.9 * FRAMES  # pictures, not black
    assert min(before) > 1 << 20
    assert max(growth) < MOST_GROWTH, growth


@pytest.mark.parametrize("cause", [signal.SIGSEGV, signal.SIGSTOP])
def test_the_last_frame_is_held_and_the_decoder_comes_back(cause: signal.Signals, two_seconds: Path) -> None:  # noqa: F811
    """The bounds are the issue's: no poll takes a second while the decoder is away, and it is back within five.

    The reader is polled as a session polls it, and what its decoder had decoded ahead is taken first.
    """
    with MediaReader.open(two_seconds, loop=True) as reader:
        held = _next(reader)
        kept = [plane.copy() for plane in held.planes]
        pid = reader.decoder_pid
        os.kill(pid, cause)
        struck_at, longest, frames = time.monotonic(), 0.0, [held]
        while reader.decoder_pid == pid or frames[-1].slot[0] == held.slot[0]:
            before = time.monotonic()
            frame = reader.poll()
            longest = max(longest, time.monotonic() - before)
            if frame is not None:
                frames.append(frame)
                reader.release(frame)
            assert before - struck_at < PATIENCE_S
            time.sleep(0.01)
        back_s = time.monotonic() - struck_at
        for plane, copy in zip(held.planes, kept, strict=True):
            np.testing.assert_array_equal(plane, copy)  # a frame that was not released stays what it was
        (notice,) = reader.notices()
    assert "restarted" in notice
    assert [frame.index for frame in frames] == list(range(frames[0].index, frames[0].index + len(frames)))
    assert longest < HELD_S
    assert back_s < BACK_S


def _next(reader: MediaReader) -> Frame:
    frame = reader.next_frame(PATIENCE_S)
    assert frame is not None
    return frame
