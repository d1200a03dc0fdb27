"""Refinement within a budget of milliseconds per frame on this machine: whole commands, as a user runs them."""

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

from counterlight.tools.shipped import CLIP
from tests.programs import succeed

ROOMS, SIZES = ("wall", "corner"), ("--camera", "640x480", "--projector", "512x384")
BUDGETS = 16, 40, 160


def budgets() -> Iterator[str]:
    """The shipped film rendered under `play --budget MS`: frame times, and the distance from the best picture."""
    yield "| room | budget, ms | a frame, median, ms | 95 % below, ms | steps at the end | dB below the best |"
    yield "|---|---|---|---|---|---|"
    with tempfile.TemporaryDirectory() as name:
        for room in ROOMS:
            folder = Path(name) / room
            succeed("simulate", room, *SIZES, "-o", folder)
            succeed("build", folder)
            for budget in BUDGETS:
                yield f"| {room} | {budget} | {' | '.join(_played(folder, budget))} |"


def _played(room: Path, budget: float) -> list[str]:
    stats = room.parent / "stats.json"
    succeed("play", room, CLIP, "--budget", budget, "--output", room.parent / "film.mkv", "--stats", stats)
    found = json.loads(stats.read_text())
    took, stands = found["gpu_ms"], found["refinement"]
    return [f"{took['median']:.1f}", f"{took['p95']:.1f}", f"{stands['steps']}", f"{stands['below_optimum_db']:.2f}"]
