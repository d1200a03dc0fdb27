"""Every cluster solved by itself (thesis 4.2.1): dense, batched by shape, on all cores; larger ones by Krylov steps."""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from counterlight.tools.clusters.blocks import Batch, ClusterBlocks
from counterlight.tools.clusters.finite import CAUSES, NonFiniteError, describe_cluster
from counterlight.tools.jobs import run_jobs
from counterlight.tools.solve.krylov import least_squares
from counterlight.tools.solve.solution import Solution
from counterlight.tools.solve.system import LinearSystem

FloatArray = NDArray[np.float64]
DenseSolver = Callable[[FloatArray, FloatArray], tuple[FloatArray, NDArray[np.bool_]]]
LargeSolver = Callable[[LinearSystem], Solution]
LARGEST_BLOCK = 1 << 22  # camera times projector pixels of a cluster solved densely; an SVD of that takes some 20 s
BATCH_VALUES = 1 << 20


def solve_clusters(
    system: LinearSystem, dense: DenseSolver, unusual: str, large: LargeSolver | None = None
) -> Solution:
    """Solve each cluster by `dense`, and what is too large for that by `large`.

    dense : blocks (k, m, n) and b (k, m) -> p (k, n), and (k,) whether a block needed special treatment.
    unusual : what that was, for the note "3 of 120 clusters …".
    large : default is least squares of minimum norm by LSMR.
    Far light joins everything into one cluster, which `large` takes.
    Raises NonFiniteError, naming the cluster, if a result is not finite.
    """
    large = least_squares if large is None else large
    if system.far is not None:
        solution = large(system)
        _refuse_not_finite(system, solution.unclamped)
        return solution
    clusters = system.clusters
    fits = clusters.camera_sizes * clusters.projector_sizes <= LARGEST_BLOCK
    drive, notes = np.zeros(system.shape[1]), list[str]()
    blocks = ClusterBlocks(clusters, fits)
    entries = blocks.entries(system.near)

    def work(batch: Batch) -> tuple[Batch, FloatArray, NDArray[np.bool_]]:
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # what is not finite is refused below
            return batch, *dense(blocks.dense(entries, batch), system.target[batch.camera])

    special = 0
    jobs = [partial(work, batch) for batch in blocks.batches(BATCH_VALUES)]
    for batch, p, treated in run_jobs(jobs, "solving clusters"):
        drive[batch.projector] = p
        special += int(treated.sum())
    if special:
        notes.append(f"{special} of {clusters.count} clusters {unusual}")
    if not fits.all():
        rest = _only(system, ~fits)
        solution = large(rest)
        drive += np.where(np.isin(clusters.projector, np.flatnonzero(~fits)), solution.unclamped, 0.0)
        largest = int(clusters.projector_sizes.max())
        notes += [f"{int((~fits).sum())} clusters of up to {largest} projector pixels: {n}" for n in solution.notes]
    _refuse_not_finite(system, drive)
    return Solution(drive, tuple(notes))


def _only(system: LinearSystem, chosen: NDArray[np.bool_]) -> LinearSystem:
    """The system with the rows of the other clusters left empty."""
    label = system.clusters.camera
    keep = (label >= 0) & chosen[label]
    near = system.near.copy()
    near.data[~np.repeat(keep, np.diff(near.indptr))] = 0
    near.eliminate_zeros()
    return LinearSystem(near, np.where(keep, system.target, 0.0))


def _refuse_not_finite(system: LinearSystem, drive: FloatArray) -> None:
    bad = np.flatnonzero(~np.isfinite(drive))
    if bad.size:
        where = describe_cluster(system.clusters, int(system.clusters.projector[bad[0]]))
        raise NonFiniteError(f"the solution overflows in {where}; {CAUSES}")
