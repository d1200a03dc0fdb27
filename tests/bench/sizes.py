"""Cost of the default build of a simulated room at a given size, with its choices and its quality."""

import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from counterlight import calibration
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.shipped import parse_scene
from counterlight.tools.simulation.room import fill_simulated_room
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.simulation.simulate import simulate
from tests.bench.rows import Timed

FULL_HD = (1080, 1920)


def default_build() -> Iterator[object]:
    """The wall at 1920x1080, camera and projector: counterlight build without options."""
    scene = load_scene(parse_scene("wall")).resized(FULL_HD, FULL_HD)
    with tempfile.TemporaryDirectory() as name:
        room = Path(name) / "wall"
        with calibration.replacing(room, force=False, inputs=[]) as stage:
            fill_simulated_room(scene, [simulate(scene)], stage)
        start, processor = time.perf_counter(), time.process_time()
        built = build_room_maps(calibration.read(room), InverseOptions())
        elapsed, processor = time.perf_counter() - start, time.process_time() - processor
    yield Timed(f"default build, {built.conclusion}", elapsed, goal_s=60)
    yield f"  processor {processor:.0f} s; most memory so far: {_gibibytes():.1f} GiB (goal 6 GiB)"


def _gibibytes() -> float:
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**30
