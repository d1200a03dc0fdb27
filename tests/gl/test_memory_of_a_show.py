"""A player in a window takes no more memory, descriptors and threads after hundreds of reloads and media."""

import gc
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import pytest

from counterlight.gl.renderer import GlRenderer
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.refinement import STARTS
from counterlight.pipeline.views import VIEWS
from counterlight.unattended.heartbeat import rss_bytes
from tests.media import numbered, write_video
from tests.programs import descendants, wait_until
from tests.refined_rooms import physical_room
from tests.remote import Client, show
from tests.rooms import rgb_frame

WARM_UP, SAMPLES = 20, 20
MOST_GROWTH = (10 << 20) / 1000  # the bound, of one reload
STEP = 4 << 20  # Python's table of names is made anew now and then, larger: 900 reloads cost no more than that in all


def growth(pid: int, act: Callable[[], None], count: int) -> float:
    """Bytes that each act costs beyond a STEP: medians, since the heap's size goes up and down by a MiB or two."""
    sizes = []
    for index in range(WARM_UP + count + SAMPLES):
        act()
        if not WARM_UP + SAMPLES <= index < WARM_UP + count:
            sizes.append(rss_bytes(pid) or 0)
    grown = float(np.median(sizes[-SAMPLES:]) - np.median(sizes[WARM_UP : WARM_UP + SAMPLES]))
    return max(grown - STEP, 0.0) / count


def shown(client: Client, process: Any) -> None:
    """A frame more is shown."""
    before = client.get("frames")
    wait_until(lambda: client.get("frames") > before, "a frame", process, every_s=0.005)


def test_reloads_take_no_memory(xvfb: str, small_room: Path, folder: Path) -> None:
    with show(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, client):

        def reload() -> None:
            assert client.ask("reload")["error"] == "success"
            shown(client, process)

        assert growth(process.pid, reload, 200) < MOST_GROWTH


def test_media_take_neither_memory_nor_anything_else(xvfb: str, small_room: Path, folder: Path) -> None:
    names = []
    for n, shape in enumerate([(48, 64), (96, 128)]):
        names.append(f"{n}.mkv")
        write_video(folder / names[-1], [numbered(i, *shape) for i in range(50)])
    with show(xvfb, folder, small_room, "clip.mkv", "--loop") as (process, client):

        def load() -> None:
            names.append(names.pop(0))
            assert client.ask("loadfile", names[-1])["error"] == "success"
            wait_until(lambda: client.get("path") == names[-1], "the medium", process, every_s=0.005)

        def held() -> tuple[int, int]:
            tasks, descriptors = (list(Path(f"/proc/{process.pid}/{kind}").iterdir()) for kind in ("task", "fd"))
            return len(tasks), len(descriptors)

        before = held()
        assert growth(process.pid, load, 100) < 2 * MOST_GROWTH  # a smaller number of media, the heap as restless
        wait_until(lambda: held() == before, "what the last medium took is given back", process)
        assert len(descendants(process.pid)) == 1


@pytest.mark.parametrize("start", STARTS)
def test_a_room_is_freed_with_its_renderer(gl_context: moderngl.Context, rng: np.random.Generator, start: str) -> None:
    """By reference counts: a collection may not come for hours. Every view has been drawn, with all it can hold."""
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
