"""Cost of acquisition: scheduling blocks, T from measured entries, and a whole simulated acquisition."""

import resource
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from counterlight.files.picture_files import decode, encode_png
from counterlight.tools.acquisition.plan import Noise
from counterlight.tools.acquisition.schemes.blocks import BlockGrid, BlockLight, as_transport
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme
from counterlight.tools.acquisition.schemes.known import KnownLight, Quarter
from counterlight.tools.acquisition.schemes.multiplexed import MultiplexedScheme
from counterlight.tools.acquisition.schemes.schedule import colour_graph, conflict_graph
from tests.acquired_rooms import room_of, run, sharp_wall
from tests.bench.rows import Timed

CAMERA, BLOCKS = (480, 640), (512, 512)
WINDOW = 3  # blocks per side that a camera pixel sees
SECOND_PLACE = 0.02  # share of the camera pixels that see a second window: a mirror, an edge


def schedule() -> Iterator[object]:
    """The conflict graph of 512x512 blocks seen by a 640x480 camera, its colouring, and T of the same entries."""
    camera, block = seen_blocks(np.random.default_rng(1))
    made: dict[str, Any] = {}
    yield stage("conflict graph", made, lambda: conflict_graph(camera, block, BLOCKS[0] * BLOCKS[1]))
    graph = made["conflict graph"]
    yield f"{camera.size} entries, {graph.nnz // 2} conflicts"
    yield stage("colours", made, lambda: colour_graph(graph))
    yield f"{made['colours'].max() + 1} colours; the largest clique has at least {WINDOW**2} blocks"
    entries = BlockLight(BlockGrid(BLOCKS, 1), camera, block, np.ones((camera.size, 3)))
    yield stage("T in CSR", made, lambda: as_transport([entries], CAMERA[0] * CAMERA[1]))
    yield f"most memory of this process so far: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB"


def stage(name: str, made: dict[str, Any], work: Callable[[], object]) -> str:
    """Run a stage once; returns wall and processor time, because other load affects only wall time."""
    wall, processor = time.perf_counter(), time.process_time()
    made[name] = work()
    return f"{name}: {time.perf_counter() - wall:.1f} s, processor {time.process_time() - processor:.1f} s"


def seen_blocks(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Returns (camera pixel, block) of each connection."""
    row, column = np.mgrid[: CAMERA[0], : CAMERA[1]].reshape(2, -1)
    row, column = row * (BLOCKS[0] - WINDOW) // CAMERA[0], column * (BLOCKS[1] - WINDOW) // CAMERA[1]
    mirrored = np.flatnonzero(rng.random(row.size) < SECOND_PLACE)
    pixels = np.concatenate([np.arange(row.size), mirrored])
    row = np.concatenate([row, row[mirrored]])
    column = np.concatenate([column, BLOCKS[1] - WINDOW - column[mirrored]])
    down, right = np.mgrid[:WINDOW, :WINDOW].reshape(2, -1)
    block = (row[:, None] + down) * BLOCKS[1] + column[:, None] + right
    pairs = np.unique(np.repeat(pixels, WINDOW**2) * (BLOCKS[0] * BLOCKS[1]) + block.ravel())
    camera, block = np.divmod(pairs, BLOCKS[0] * BLOCKS[1])
    return camera, block


def picture() -> Iterator[object]:
    """Reading one capture of 1920x1080: a sixteenth of the 8-pixel blocks and a quarter of the camera pixels are lit.

    Twelve blocks of other sizes are known per camera pixel.
    """
    rng, raster = np.random.default_rng(1), (1080, 1920)
    pixels, grid = raster[0] * raster[1], BlockGrid(raster, 8)
    known, camera = KnownLight(pixels, raster), np.arange(pixels, dtype=np.int32)
    for side in (16, 32, 64, 128):
        coarse = BlockGrid(raster, side)
        blocks = rng.integers(0, coarse.count, 3 * pixels).astype(np.int32)
        known.add(BlockLight(coarse, np.repeat(camera, 3), blocks, rng.random((3 * pixels, 3), np.float32)))
    lit, entries = rng.choice(grid.count, grid.count // 16, replace=False), np.flatnonzero(rng.random(pixels) < 0.25)
    capture, black = rng.random((pixels, 3), np.float32), rng.random((pixels, 3))
    light, variance = (np.zeros((pixels, 3), np.float32) for _ in range(2))
    to = Quarter(camera, entries, light, variance, np.zeros(pixels, np.bool_))
    noise = Noise(np.full(3, 0.1), np.full(3, 0.01))
    for name in ("first, with compiling", "second", "third"):
        yield stage(
            f"{name}: {entries.size} connections read off the capture",
            {},
            lambda: known.read(known.shares(grid, lit), capture, black, noise, noise, to),
        )


def capture() -> Iterator[object]:
    """PNG size, write and read times of 640x480 captures: smooth light with the noise of 20 000 electrons."""
    rng, (height, width) = np.random.default_rng(1), CAMERA
    light = np.outer(np.linspace(0.2, 1, height), np.linspace(0.2, 1, width))[..., None] * (1.0, 0.9, 0.8)
    for bits, kind in ((14, np.uint16), (8, np.uint8)):
        for name, share in (("white", 0.8), ("one of 64 blocks lit", 0.8 / 64)):
            electrons = rng.poisson(20000 * share * light) + rng.normal(0, 5, light.shape)
            codes = np.clip(np.rint(electrons / 20000 * (2**bits - 1)), 0, 2**bits - 1)
            stored = (codes * (np.iinfo(kind).max / (2**bits - 1))).astype(kind)
            content, write_ms = _milliseconds(partial(encode_png, stored))
            _, read_ms = _milliseconds(partial(decode, content, "a capture"))
            size = f"{bits} bits, {name}: {len(content) / stored.nbytes:.0%} of its size"
            yield f"{size}, processor {write_ms:.0f} ms to write, {read_ms:.0f} ms to read"


def _milliseconds(work: Callable[[], Any]) -> tuple[Any, float]:
    """Returns the result of `work`, and the least processor time of ten runs."""
    took = []
    for _ in range(10):
        start = time.process_time()
        made = work()
        took.append(time.process_time() - start)
    return made, 1e3 * min(took)


def whole() -> Iterator[object]:
    """A whole acquisition of a wall, 26x18 camera and 30x21 projector pixels, captures in memory."""
    room = room_of(sharp_wall(np.random.default_rng(1)))
    for scheme in (HierarchicalScheme(), MultiplexedScheme()):
        done = run(room, scheme)
        yield Timed(f"{type(scheme).__name__}, {done.pictures} pictures", done.seconds)
