"""Memory stays flat while a clip is looped, in the player's process and in the decoder's."""

import gc
from pathlib import Path

import av
import moderngl
import numpy as np
import pytest

from counterlight.gl.renderer import GlRenderer
from counterlight.media.video import MediaReader
from tests.gl_objects import live_objects
from tests.rooms import random_room

FRAMES, LOOPS = 50, 500
WARM_UP_LOOPS = 20


def resident_bytes(pid: int | str) -> int:
    fields = Path(f"/proc/{pid}/status").read_text().partition("VmRSS:")[2].split()
    return int(fields[0]) * 1024


@pytest.fixture
def two_seconds(tmp_path: Path, rng: np.random.Generator) -> Path:
    path = tmp_path / "clip.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for _ in range(FRAMES):
            picture = rng.integers(0, 255, (48, 64, 3), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))
    return path


def test_five_hundred_loops_leave_memory_and_gl_objects_as_they_were(
    gl_context: moderngl.Context, rng: np.random.Generator, two_seconds: Path
) -> None:
    renderer = GlRenderer(gl_context, random_room(rng, far=True))
    with MediaReader.open(two_seconds, loop=True) as reader:
        renderer.open(reader.info.format)
        processes = ("self", reader.decoder_pid)
        before, objects = [0, 0], None
        for index in range(FRAMES * LOOPS):
            if index == FRAMES * WARM_UP_LOOPS:
                gc.collect()
                before = [resident_bytes(pid) for pid in processes]
                objects = live_objects()  # some passes are made when they are first asked for
            frame = reader.next_frame(60)
            assert frame is not None
            renderer.upload(frame)
            reader.release(frame)
            renderer.render("projector", compensate=True, frame=index)
            if index % FRAMES == 0:
                renderer.encoded()
        gc.collect()
        growth = [resident_bytes(pid) - start for pid, start in zip(processes, before, strict=True)]
        assert live_objects() == objects
    renderer.release()
    assert frame.time_s > 0.99 * LOOPS * FRAMES / 25
    assert max(growth) < 10 << 20  # the bound for 500 loops
