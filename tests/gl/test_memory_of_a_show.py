"""A player in a window needs no more memory, descriptors and threads after reloads and media changes."""

import gc
import weakref
from collections.abc import Callable
from pathlib import Path

import moderngl
import numpy as np
import pytest

from counterlight.gl.renderer import GlRenderer
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.refinement import STARTS
from counterlight.pipeline.room import read_room
from counterlight.pipeline.views import VIEWS
from counterlight.unattended.heartbeat import rss_bytes
from tests.media import numbered, write_video
from tests.programs import descendants, wait_until
from tests.refined_rooms import physical_room
from tests.remote import show
from tests.rooms import rgb_frame

WARM_UP, ACTS = 6, 12
SIZES = (360, 480), (480, 640)  # sizes of media


def grown(pid: int, act: Callable[[], None]) -> int:
    """Return the bytes by which some actions enlarge a process, after the first few."""
    for _ in range(WARM_UP):
        act()
    before = rss_bytes(pid) or 0
    for _ in range(ACTS):
        act()
    return (rss_bytes(pid) or 0) - before


def test_reloads_take_no_memory(xvfb: str, plain_room: Path, folder: Path) -> None:
    """Maps take 23 MiB, so a leak in half of the reloads would be detected.

    `make fuzz` runs many reloads of small maps.
    """
    maps = sum(each.nbytes for each in read_room(plain_room, None).maps.named().values())
    with show(xvfb, folder, plain_room, "clip.mkv", "--loop") as (process, client):

        def reload() -> None:
            assert client.ask("reload")["error"] == "success"
            before = client.get("frames")
            wait_until(lambda: client.get("frames") > before, "a frame", process, every_s=0.005)

        assert grown(process.pid, reload) < ACTS / 2 * maps


def test_media_take_neither_memory_nor_anything_else(xvfb: str, small_room: Path, folder: Path) -> None:
    """The media are so large that a leak of one linear picture in half of them would be detected."""
    picture = sum(height * width * 4 * 4 for height, width in SIZES) / len(SIZES)
    names = []
    for n, shape in enumerate(SIZES):
        names.append(f"{n}.mkv")
        write_video(folder / names[-1], [numbered(i, *shape) for i in range(10)])
    with show(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, client):

        def load() -> None:
            names.append(names.pop(0))
            assert client.ask("loadfile", names[-1])["error"] == "success"
            wait_until(lambda: client.get("path") == names[-1], "the medium", process, every_s=0.005)

        def held() -> tuple[int, int]:
            tasks, descriptors = (list(Path(f"/proc/{process.pid}/{kind}").iterdir()) for kind in ("task", "fd"))
            return len(tasks), len(descriptors)

        before = held()
        assert grown(process.pid, load) < ACTS / 2 * picture
        wait_until(lambda: held() == before, "what the last medium took is given back", process)
        assert len(descendants(process.pid)) == 1


@pytest.mark.parametrize("start", STARTS)
def test_a_room_is_freed_with_its_renderer(gl_context: moderngl.Context, rng: np.random.Generator, start: str) -> None:
    """Reference counts free the room, because a collection may be hours away.

    Every view was drawn with all its objects.
    """
    room = physical_room(rng, start=start).room
    kept, frame = weakref.ref(room), rgb_frame(rng.integers(0, 255, (9, 12, 3), np.uint8))
    gc.collect()
    gc.disable()
    try:
        renderer = GlRenderer(gl_context, room)
        renderer.open(frame.format)
        renderer.adjust(Adjustments(adapt=2, black_level=0.1, flicker=0.5, clipping=True))
        renderer.upload(frame)
        for view in VIEWS:
            renderer.render(view, compensate=True, steps=2)
        renderer.certificate()
        renderer.release()
        del room, renderer
        assert kept() is None
    finally:
        gc.enable()
