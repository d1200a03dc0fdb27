"""What one picture costs by the CPU solvers, three channels, beside scipy's solvers looped over the same clusters.

scipy is measured on evenly spaced clusters and scaled to all, where all would take minutes.
"""

from collections.abc import Callable, Iterator

import numpy as np
from scipy.optimize import lsq_linear, nnls

from counterlight.tools.clusters.blocks import ClusterBlocks
from counterlight.tools.inverse.pictures import typical_pictures
from counterlight.tools.solve.registry import solve_channels
from counterlight.tools.solve.system import LinearSystem
from counterlight.tools.transport.transport import Csr
from tests.bench_rooms import CAMERA, FOCUS_CAMERA, focus, wall, wall_decomposed
from tests.bench_rows import Timed, seconds

FloatArray = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
SAMPLED_CLUSTERS = 150
REPEATS = 3


def box() -> Iterator[Timed]:
    """The box optimum to a relative gap of 1e-4, of T decomposed and as it is."""
    cut = systems(wall_decomposed()[1].matrices, CAMERA)
    name, baseline = looped(cut, "lsq_linear", lambda block, b: lsq_linear(block, b, (0, 1)))
    solve_channels("box", systems(focus(), FOCUS_CAMERA))  # compiles
    ours = seconds(lambda: solve_channels("box", cut), REPEATS)
    yield Timed("box, decomposed T", ours, name, baseline, 5)
    whole = systems(wall(), CAMERA)
    yield Timed("box, T as it is", seconds(lambda: solve_channels("box", whole)), goal_s=5)


def non_negative() -> Iterator[Timed]:
    """NNLS of each cluster of the decomposed T."""
    cut = systems(wall_decomposed()[1].matrices, CAMERA)
    name, baseline = looped(cut, "nnls", lambda block, b: nnls(block, b, maxiter=30 * block.shape[1]))
    yield Timed("nnls, decomposed T", seconds(lambda: solve_channels("nnls", cut)), name, baseline, 60)


def focus_experiment() -> Iterator[Timed]:
    """The thesis' 48x48 pictures out of focus, one system of 2304x2700 a channel, not decomposed."""
    whole = systems(focus(), FOCUS_CAMERA)
    ours = seconds(lambda: solve_channels("box", whole), REPEATS)
    spent = seconds(lambda: lsq_linear(whole[0].near, whole[0].target, (0, 1), lsq_solver="lsmr"))
    name = "scipy's lsq_linear (sparse, 100 steps; one channel measured, times 3)"
    yield Timed("focus experiment, box", ours, name, 3 * spent, 1)


def systems(matrices: tuple[Csr, ...], camera: tuple[int, int]) -> list[LinearSystem]:
    """A photograph at the white level that nine in ten camera pixels reach."""
    picture = typical_pictures(camera)[0].ravel()
    wide = [T.astype(np.float64) for T in matrices]
    return [LinearSystem(T, np.percentile(T @ np.ones(T.shape[1]), 10) * picture) for T in wide]


def looped(
    channels: list[LinearSystem], name: str, solve: Callable[[FloatArray, FloatArray], object]
) -> tuple[str, float]:
    """What scipy's `solve` takes for all clusters of all channels, from a sample of them."""
    clusters = channels[0].clusters
    chosen = np.linspace(0, clusters.count - 1, SAMPLED_CLUSTERS).astype(int)
    blocks = ClusterBlocks(clusters, np.isin(np.arange(clusters.count), chosen))
    spent = sum(_loop(blocks, system, solve) for system in channels)
    count = 3 * clusters.count
    return (
        f"scipy's {name} ({count} clusters; {3 * chosen.size} measured, scaled)",
        spent * clusters.count / chosen.size,
    )


def _loop(blocks: ClusterBlocks, system: LinearSystem, solve: Callable[[FloatArray, FloatArray], object]) -> float:
    entries = blocks.entries(system.near)
    parts = [(blocks.dense(entries, batch), system.target[batch.camera]) for batch in blocks.batches(1 << 20)]
    return seconds(lambda: [solve(*pair) for part in parts for pair in zip(*part, strict=True)])
