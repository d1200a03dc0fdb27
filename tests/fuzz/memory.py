"""Memory of a show that is reloaded, given other media, or just continues, and of a renderer without a window.

Memory grows by at most 10 MiB, however long a campaign takes.
"""

import gc
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import moderngl
import numpy as np

from counterlight.gl.context import headless_context
from counterlight.gl.renderer import GlRenderer
from counterlight.media.video import MediaReader
from counterlight.tools import build_correction_map
from counterlight.unattended.heartbeat import rss_bytes
from tests import screens
from tests.fuzz.evening import HANDS_OFF, drawn_value
from tests.fuzz.tally import GREEDY, READ, WRONG, Plan, Tally, Trial
from tests.gl_objects import live_objects
from tests.media import TIMEOUT_S, numbered, write_h264, write_video
from tests.programs import descendants, wait_until
from tests.remote import Client, show
from tests.rooms import random_room, write_blurred_room

MOST_GROWTH = 10 << 20  # in bytes, however long the run is
STEP, PER_ACT = (
    4 << 20,
    MOST_GROWTH / 1000,
)  # bytes in a short run: Python's name table occasionally grows
WARM_UP, SAMPLES = 20, 15  # actions before the first measurement; measurements per median
DAY_S = 24 * 3600
SETTLED_S = 0.1  # a setting takes a frame or two
CLIPS = {"0.mkv": (48, 64), "1.mkv": (96, 128)}
Act = Callable[[], None]


class _Growth(ABC):
    """Repeats actions, and compares the medians of the last and first measurements, because the heap varies."""

    name: str
    count: int
    purpose: str
    warm_up = WARM_UP
    per_act: float = MOST_GROWTH  # bytes that each action may cost beyond a STEP

    @abstractmethod
    def act(self, client: Client, process: Any) -> Act:
        """Perform the action that is repeated, in a looping show."""

    def grown(self, sizes: list[int]) -> float:
        """Return the bytes that the actions have cost."""
        return float(np.median(sizes[-SAMPLES:]) - np.median(sizes[:SAMPLES]))

    def run(self, plan: Plan) -> Tally:
        tally, sizes, held = Tally(self.name, plan), [], []
        with looping(plan.scratch) as (process, client):
            act = self.act(client, process)
            for _ in range(self.warm_up):
                act()
            for index in plan.indices():
                act()
                sizes.append(_resident(process.pid))
                held.append(_held(process.pid))
                tally.add(index, Trial(READ))
        grown = self.grown(sizes)
        tally.notes["grown"] = f"{grown / 2**20:+.2f} MiB"
        tally.peak = max(sizes)
        if grown > min(MOST_GROWTH, STEP + self.per_act * len(sizes)) or max(held[-SAMPLES:]) > max(held[:SAMPLES]) + 5:
            tally.add(
                plan.first, Trial(GREEDY, f"{grown / 2**20:.1f} MiB, {held[0]} to {held[-1]} threads and descriptors")
            )
        return tally


class Reloads(_Growth):
    name, count = "reloads", 200
    purpose = "reload of the maps and shaders; memory must stay flat"
    per_act = PER_ACT

    def act(self, client: Client, process: Any) -> Act:
        def reload() -> None:
            assert client.ask("reload")["error"] == "success"
            before = client.get("frames")
            wait_until(lambda: client.get("frames") > before, "a frame", process, every_s=0.005)

        return reload


class Loadfiles(_Growth):
    name, count = "loadfiles", 100
    purpose = "another medium of another size; memory must stay flat"
    per_act = 2 * PER_ACT  # the run has fewer actions, but the heap varies as much as in a longer run

    def act(self, client: Client, process: Any) -> Act:
        names = list(CLIPS)

        def load() -> None:
            names.append(names.pop(0))
            assert client.ask("loadfile", names[-1])["error"] == "success"
            wait_until(lambda: client.get("path") == names[-1], "the medium", process, every_s=0.005)

        return load


class Settings(_Growth):
    name, count = "settings", 500
    purpose = "one random setting after another; memory must stay flat"
    warm_up = 300  # until every view and page has been shown once

    def act(self, client: Client, process: Any) -> Act:
        rng = np.random.default_rng(3)
        kept = HANDS_OFF | {"loop-file"}  # with these settings changed, the show would end
        known = [each for each in client.get("property-info") if each["writable"] and each["name"] not in kept]

        def put() -> None:
            info = known[rng.integers(len(known))]
            client.ask("set_property", info["name"], drawn_value(rng, info))
            time.sleep(SETTLED_S)

        return put


class Seconds(_Growth):
    name, count = "seconds", 45
    purpose = "a show that loops; memory extrapolated to 24 hours must stay flat"

    def act(self, client: Client, process: Any) -> Act:
        def second() -> None:
            before = client.get("frames")
            wait_until(lambda: client.get("frames") >= before + 25, "a second of frames", process, every_s=0.2)

        return second

    def grown(self, sizes: list[int]) -> float:
        """Return the growth per day from a line through the later half, when caches are full.

        A quarter of a MiB may be noise.
        """
        late = np.array(sizes[len(sizes) // 2 :], float)
        slope = np.polyfit(np.arange(late.size), late, 1)[0]
        return float(slope * DAY_S) if abs(slope) * late.size > 256 << 10 else 0.0


class Frames:
    """Frames are decoded, uploaded, rendered and read back, as in a player without a window."""

    name, count = "frames", 25_000
    purpose = "frames of a clip that loops, without a window; memory and OpenGL objects must stay as they were"
    warm_up = 1000

    def run(self, plan: Plan) -> Tally:
        tally = Tally(self.name, plan)
        clip = write_h264(plan.scratch / "clip.mp4", 50)
        with headless_context() as context, context, MediaReader.open(clip, loop=True) as reader:
            context.gc_mode = "context_gc"
            with drawing(context, reader, plan.rng(self.name, 0)) as draw:
                for _ in range(self.warm_up):
                    draw()
                before, objects, decoder = sizes(reader), live_objects(), reader.decoder_pid
                for index in plan.indices():
                    tally.add(index, Trial(READ) if draw() else Trial(WRONG, "a black picture"))
                grown, left = max(np.subtract(sizes(reader), before)), live_objects()
            tally.notes["grown"], tally.peak = f"{grown / 2**20:+.2f} MiB", max(sizes(reader))
            if grown > MOST_GROWTH or left != objects:
                tally.add(plan.first, Trial(GREEDY, f"{grown / 2**20:.1f} MiB, OpenGL objects {objects} to {left}"))
            if reader.decoder_pid != decoder:
                tally.add(plan.first, Trial(WRONG, "the decoder was replaced"))
        return tally


@contextmanager
def drawing(context: moderngl.Context, reader: MediaReader, rng: np.random.Generator) -> Iterator[Callable[[], bool]]:
    """Yield a function that draws the next frame in a random room, and returns whether its picture has light."""
    renderer = GlRenderer(context, random_room(rng, far=True))
    renderer.open(reader.info.format)

    def draw() -> bool:
        frame = reader.next_frame(TIMEOUT_S)
        assert frame is not None
        renderer.upload(frame)
        reader.release(frame)
        renderer.render("projector", compensate=True, frame=frame.index)
        return bool(renderer.encoded().any())

    yield draw
    renderer.release()


def sizes(reader: MediaReader) -> list[int]:
    """Return the bytes of this process and of the decoder."""
    gc.collect()
    return [rss_bytes(pid) or 0 for pid in ("self", reader.decoder_pid)]


@contextmanager
def looping(folder: Path) -> Iterator[tuple[Any, Client]]:
    write_blurred_room(folder / "room", np.random.default_rng(7), (30, 40), (28, 36))
    assert build_correction_map.main([str(folder / "room"), "--regularize", "0.1"]) == 0
    for name, shape in CLIPS.items():
        write_video(folder / name, [numbered(i, *shape) for i in range(50)])
    with screens.one_screen(folder) as display, show(display, folder, folder / "room", "0.mkv", "--loop") as found:
        yield found


def _resident(pid: int) -> int:
    """Return the resident bytes of the player and its decoder."""
    return sum(rss_bytes(each) or 0 for each in (pid, *descendants(pid)))


def _held(pid: int) -> int:
    return sum(len(list(Path(f"/proc/{pid}/{kind}").iterdir())) for kind in ("task", "fd"))
