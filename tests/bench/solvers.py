"""Cost of one picture by the CPU solvers, three channels, next to scipy's solvers looped over the same clusters.

scipy is measured on evenly spaced clusters and scaled to all, because all would take minutes.
"""

from collections.abc import Callable, Iterator

import numpy as np
from scipy.optimize import lsq_linear, nnls

from counterlight.maps.row_map import SparseRows
from counterlight.tools.clusters.blocks import ClusterBlocks
from counterlight.tools.inverse.pictures import typical_pictures
from counterlight.tools.solve.channel import Channel
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.transport import Transport, stacked
from tests.bench.rooms import CAMERA, FOCUS_CAMERA, focus, wall, wall_decomposed
from tests.bench.rows import Timed, seconds

FloatArray = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
SAMPLED_CLUSTERS = 150
REPEATS = 3


def box() -> Iterator[Timed]:
    """The box optimum to a relative gap of 1e-4, for T decomposed and undecomposed."""
    T, b = task(wall_decomposed()[1].near, CAMERA)
    name, baseline = looped(T, b, "lsq_linear", lambda block, b: lsq_linear(block, b, (0, 1)))
    small, picture = task(stacked(focus()), FOCUS_CAMERA)
    prepare("box", small).solve(picture)  # compiles the loops before the timing
    ours = seconds(lambda: prepare("box", T).solve(b), REPEATS)
    yield Timed("box, decomposed T", ours, name, baseline, 5)
    whole, picture = task(stacked(wall()), CAMERA)
    yield Timed("box, T as it is", seconds(lambda: prepare("box", whole).solve(picture)), goal_s=5)


def non_negative() -> Iterator[Timed]:
    """NNLS of each cluster of the decomposed T."""
    T, b = task(wall_decomposed()[1].near, CAMERA)
    name, baseline = looped(T, b, "nnls", lambda block, b: nnls(block, b, maxiter=30 * block.shape[1]))
    yield Timed("nnls, decomposed T", seconds(lambda: prepare("nnls", T).solve(b)), name, baseline, 60)


def focus_experiment() -> Iterator[Timed]:
    """The thesis' 48x48 pictures out of focus, one undecomposed system of 2304x2700 per channel."""
    T, b = task(stacked(focus()), FOCUS_CAMERA)
    ours = seconds(lambda: prepare("box", T).solve(b), REPEATS)
    spent = seconds(lambda: lsq_linear(Channel.of(T, 0).near, b[:, 0], (0, 1), lsq_solver="lsmr"))
    name = "scipy's lsq_linear (sparse, 100 steps; one channel measured, times 3)"
    yield Timed("focus experiment, box", ours, name, 3 * spent, 1)


def task(near: SparseRows, camera: tuple[int, int]) -> tuple[Transport, FloatArray]:
    """Returns T, and as b a photograph at the white level that nine in ten camera pixels reach."""
    T, picture = Transport(near), typical_pictures(camera)[0].ravel()
    return T, np.percentile(T.composition(), 10, axis=0) * picture[:, None]


def looped(
    T: Transport, b: FloatArray, name: str, solve: Callable[[FloatArray, FloatArray], object]
) -> tuple[str, float]:
    """Returns a name and the time of scipy's `solve` for all clusters of all channels, estimated from a sample."""
    channels = [Channel.of(T, i) for i in range(3)]
    clusters = channels[0].clusters
    chosen = np.linspace(0, clusters.count - 1, SAMPLED_CLUSTERS).astype(int)
    blocks = ClusterBlocks(clusters, np.isin(np.arange(clusters.count), chosen))
    spent = sum(_loop(blocks, one, b[:, i], solve) for i, one in enumerate(channels))
    count = 3 * clusters.count
    return (
        f"scipy's {name} ({count} clusters; {3 * chosen.size} measured, scaled)",
        spent * clusters.count / chosen.size,
    )


def _loop(blocks: ClusterBlocks, T: Channel, b: FloatArray, solve: Callable[[FloatArray, FloatArray], object]) -> float:
    entries = blocks.entries(T.near)
    parts = [(blocks.dense(entries, batch), b[batch.camera]) for batch in blocks.batches(1 << 20)]
    return seconds(lambda: [solve(*pair) for part in parts for pair in zip(*part, strict=True)])
