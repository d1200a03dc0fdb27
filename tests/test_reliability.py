"""Unattended shows: memory and OpenGL objects do not grow, and the decoder may crash or stop."""

import os
import signal
import time
from pathlib import Path

import av
import moderngl
import numpy as np
import pytest

from counterlight.media.video import Frame, MediaReader
from tests.fuzz.memory import MOST_GROWTH, drawing, sizes
from tests.gl_objects import live_objects
from tests.media import numbered, write_video

WARM_UP, FRAMES = 100, 300
HELD_S, BACK_S = 1.0, 5.0  # required: longest time of a loop, time until the decoder is back
PATIENCE_S = 60.0


@pytest.fixture
def two_seconds(tmp_path: Path, rng: np.random.Generator) -> Path:
    path = tmp_path / "clip.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for _ in range(50):
            picture = rng.integers(0, 255, (48, 64, 3), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))
    return path


def test_frames_leave_memory_and_objects_as_they_were(
    gl_context: moderngl.Context, rng: np.random.Generator, tmp_path: Path
) -> None:
    """Frames are large: keeping one at each draw would cost 34 MiB. `make fuzz` draws 25 000 small ones."""
    clip = write_video(tmp_path / "clip.mkv", [numbered(n, 240, 320) for n in range(25)])
    with MediaReader.open(clip, loop=True) as reader, drawing(gl_context, reader, rng) as draw:
        for _ in range(WARM_UP):
            draw()
        before, objects, decoder = sizes(reader), live_objects(), reader.decoder_pid
        assert all(draw() for _ in range(FRAMES))  # the pictures are not black
        assert live_objects() == objects
        assert reader.decoder_pid == decoder
        assert min(before) > 1 << 20
        assert max(np.subtract(sizes(reader), before)) < MOST_GROWTH


@pytest.mark.parametrize("cause", [signal.SIGSEGV, signal.SIGSTOP])
def test_the_last_frame_is_held_and_the_decoder_comes_back(cause: signal.Signals, two_seconds: Path) -> None:
    """No poll takes a second while the decoder is missing, and another decoder runs within five seconds.

    The test polls the reader as a session does, and first takes the frames that were already decoded.
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
            np.testing.assert_array_equal(plane, copy)  # a frame that the reader still holds stays unchanged
        (notice,) = reader.notices()
    assert "restarted" in notice
    assert [frame.index for frame in frames] == list(range(frames[0].index, frames[0].index + len(frames)))
    assert longest < HELD_S
    assert back_s < BACK_S


def _next(reader: MediaReader) -> Frame:
    frame = reader.next_frame(PATIENCE_S)
    assert frame is not None
    return frame
