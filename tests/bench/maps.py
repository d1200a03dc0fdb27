"""Cost of a correction map, from T to files, next to numpy.linalg.pinv looped over the same systems.

The wall of rooms.py: camera 640x480, projector 512x512, 25 entries per column, three channels.
"""

import resource
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.response import Response
from counterlight.tools.clusters.blocks import ClusterBlocks
from counterlight.tools.clusters.components import find_clusters
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.clustered import BATCH_VALUES, clustered_jobs
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.inverse.rows import Truncation
from counterlight.tools.inverse.windows import BLOCKS, HALOS, Windows
from counterlight.tools.jobs import run_jobs
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Csr, Transport, channels
from tests.bench.rooms import CAMERA, MAX_CLUSTER, PROJECTOR, wall, wall_decomposed
from tests.bench.rows import Timed, seconds

GIB_PER_KB = 1 / (1 << 20)


def map_decomposed() -> Iterator[object]:
    """T cut into clusters of up to 200 projector pixels, λ chosen, inverted, packed, written."""
    yield _from_t_to_files(f"clusters of up to {MAX_CLUSTER}", InverseOptions(max_cluster=MAX_CLUSTER), 60)
    yield _peak()
    _, cut = wall_decomposed()
    clusters = find_clusters(channels(cut.near)[0])
    everything = np.ones(clusters.count, bool)
    truncation = Truncation(np.full((CAMERA[0] * CAMERA[1], 3), 0.3), 0.5 / 255)
    jobs = list(clustered_jobs(channels(cut.near), clusters, everything, np.full(3, 0.01), 0.0, truncation))
    ours = seconds(lambda: list(run_jobs(jobs, "inverting")))
    blocks = ClusterBlocks(clusters, everything)
    with threadpool_limits(limits=1):  # numpy's own threads would slow small clusters down
        baseline = seconds(lambda: _pinv_loop(blocks, channels(cut.near)))
    yield Timed(
        f"  of that, {clusters.count} clusters inverted and truncated", ours, "numpy.linalg.pinv, looped,", baseline
    )


def map_windowed() -> Iterator[object]:
    """The undecomposed T: one cluster, through windows."""
    total = _from_t_to_files("windowed", InverseOptions(inverse="whole"), 600)
    windows = Windows(np.ones(PROJECTOR, bool), HALOS[0], BLOCKS[0])
    corners = windows.blocks()
    block = _window(wall()[1].tocsc(), windows, corners[len(corners) // 2])
    scaled = 3 * len(corners) * seconds(lambda: np.linalg.pinv(block))
    name = f"numpy.linalg.pinv of {3 * len(corners)} windows of halo {HALOS[0]} (one measured, scaled)"
    yield Timed(total.what, total.seconds, name, scaled, total.goal_s)
    yield _peak()


def _from_t_to_files(name: str, options: InverseOptions, goal_s: float) -> Timed:
    with tempfile.TemporaryDirectory() as folder:
        stored = calibration.read(_written(Path(folder) / "wall"))
        start = time.perf_counter()
        built = build_room_maps(stored, options)
        return Timed(f"map, {name} ({built.summary})", time.perf_counter() - start, goal_s=goal_s)


def _written(folder: Path) -> Path:
    dark = np.zeros((*CAMERA, 3), np.float32)
    projector, camera = Device(*PROJECTOR, Response("srgb")), Device(*CAMERA, Response("linear"))
    room = Calibration("wall", "made by the benchmark", (projector,), camera, dark, np.ones(CAMERA, bool))
    with calibration.writing(folder, room) as stage:
        write_transport(Transport.from_matrices(wall()), stage)
    return folder


def _pinv_loop(blocks: ClusterBlocks, T: Sequence[Csr]) -> None:
    for entries in map(blocks.entries, T):
        for batch in blocks.batches(BATCH_VALUES):
            for block in blocks.dense(entries, batch):
                np.linalg.pinv(block)


def _window(columns: Csr, windows: Windows, corner: tuple[int, int]) -> np.ndarray:
    local = columns[:, windows.pixels(corner, windows.halo)]
    return local[np.unique(local.indices)].toarray()


def _peak() -> str:
    return (
        f"  most memory so far: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * GIB_PER_KB:.1f} GiB (goal 8 GiB)"
    )
