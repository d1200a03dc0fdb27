"""Solves every cluster separately (thesis 4.2.1): dense, batched by shape, on all cores.

LSMR (Fong 2011) solves larger clusters without factorisation.
"""

from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import lsmr

from counterlight.arrays import FloatArray
from counterlight.tools.clusters.blocks import Batch, ClusterBlocks
from counterlight.tools.clusters.components import CAUSES, NonFiniteError, describe_cluster
from counterlight.tools.jobs import one_thread, run_jobs
from counterlight.tools.solve.channel import Channel
from counterlight.tools.solve.solution import ChannelSolver

Blockwise: TypeAlias = Callable[[FloatArray], tuple[FloatArray, NDArray[np.bool_]]]
Factorise: TypeAlias = Callable[[FloatArray], Blockwise]
LARGEST_BLOCK = 1 << 22  # camera times projector pixels of a cluster solved densely; its SVD takes about 20 s
BATCH_VALUES = 1 << 20
MOST_KEPT = 1 << 26  # values of all blocks up to which factors are kept (512 MiB); beyond, each picture recomputes them
TOLERANCE = 1e-8
MOST_STEPS = 1000
STOPPED_AT_LIMIT = 7


class LeastSquares:
    """min ‖T p − b‖, of minimum norm because it starts from 0; its note states steps and residual."""

    def __init__(self, T: Channel) -> None:
        self._operator = T.operator

    def solve(self, b: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        with one_thread():  # products of vectors are too small for several threads
            p, reason, steps, residual, gradient, *_ = lsmr(
                self._operator, b, atol=TOLERANCE, btol=TOLERANCE, conlim=0, maxiter=MOST_STEPS
            )
        short = " (its limit: ill-conditioned)" if reason == STOPPED_AT_LIMIT else ""
        return np.asarray(p), (f"LSMR, {steps} steps{short}, ‖Tᵀr‖ {gradient:.1e}, ‖r‖ {residual:.1e}",)


class Clusterwise:
    """Solves each cluster by factors of its dense block, and larger systems by `large`.

    factorise : blocks (k, m, n) -> a function from b (k, m) to p (k, n) and whether each block is special, (k,).
    unusual : meaning of special, for the note "3 of 120 clusters …".
    large : solver for large systems; the default is least squares of minimum norm by LSMR.

    Clusters have no entries of far and blurred light: a T with such light is solved by `large` as a whole.
    """

    def __init__(
        self, T: Channel, factorise: Factorise, unusual: str, large: Callable[[Channel], ChannelSolver] = LeastSquares
    ) -> None:
        self._T, self._factorise, self._unusual = T, factorise, unusual
        self._large = None if T.in_entries else large(T)
        if not T.in_entries:
            return
        clusters = T.clusters
        sizes = clusters.camera_sizes * clusters.projector_sizes
        self._fits = sizes <= LARGEST_BLOCK
        self._blocks = ClusterBlocks(clusters, self._fits)
        self._entries, self._batches = self._blocks.entries(T.near), list(self._blocks.batches(BATCH_VALUES))
        self._rows = np.isin(clusters.camera, np.flatnonzero(~self._fits))  # rows of the clusters that are too large
        if self._rows.any():
            self._large = large(T.only(self._rows))
        self._factors: list[Blockwise] | None = None
        if sizes[self._fits].sum() <= MOST_KEPT:
            self._factors = list(
                run_jobs([partial(self._factors_of, b) for b in self._batches], "factorising clusters")
            )

    def solve(self, b: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        """Return p, (projector pixels,), and notes. Raises NonFiniteError with the cluster if p is not finite."""
        if not self._T.in_entries and self._large is not None:
            drive, notes = self._large.solve(b)
        else:
            drive, notes = self._by_clusters(b)
        bad = np.flatnonzero(~np.isfinite(drive))
        if bad.size:
            where = describe_cluster(self._T.clusters, int(self._T.clusters.projector[bad[0]]))
            raise NonFiniteError(f"the solution overflows in {where}; {CAUSES}")
        return drive, notes

    def _by_clusters(self, b: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        clusters, special, notes = self._T.clusters, 0, list[str]()
        drive = np.zeros(self._T.shape[1])
        jobs = [partial(self._block_solutions, number, b) for number in range(len(self._batches))]
        for batch, (p, treated) in zip(self._batches, run_jobs(jobs, "solving clusters"), strict=True):
            drive[batch.projector] = p
            special += int(treated.sum())
        if special:
            notes.append(f"{special} of {clusters.count} clusters {self._unusual}")
        if self._large is not None:
            p, said = self._large.solve(np.where(self._rows, b, 0.0))
            drive += np.where(np.isin(clusters.projector, np.flatnonzero(~self._fits)), p, 0.0)
            largest, count = int(clusters.projector_sizes.max()), int((~self._fits).sum())
            notes += [f"{count} clusters of up to {largest} projector pixels: {note}" for note in said]
        return drive, tuple(notes)

    def _factors_of(self, batch: Batch) -> Blockwise:
        # results that are not finite are refused afterwards
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            return self._factorise(self._blocks.dense(self._entries, batch))

    def _block_solutions(self, number: int, b: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        batch = self._batches[number]
        factors = self._factors_of(batch) if self._factors is None else self._factors[number]
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            return factors(b[batch.camera])
