"""Cuts clusters: local overlaps are removed, light from elsewhere stays (thesis 4.2.2, Appendix A).

The projector pixels that a camera pixel sees are grouped into blocks of neighbours, each around the strongest
connection that is in no block yet. Within a block, connections of at most τ₁ times the strongest are removed. A
projector pixel that lost all connections gets back its connections of at least τ₂ times the strongest. Energy is then
fitted (connections.py).

The pseudo-code leaves some choices, which are made as follows:

- Distance is Euclidean on the projector's pixel grid, so that a radius of 1 includes "only direct neighbor pixels".
- A weight is the luminance (BT.709) of the three channels, so that they keep one pattern. For equal weights, the lower
  projector index comes first (the pseudo-code takes any).
- Blocks do not overlap: "connected projector pixels of k" are those left by RemoveBlockEntryConnections. That step
  removes them from the searched list, not from the graph.
- A block's strongest connection is never removed. Taken literally, τ₁ = 1 would also remove it (luminance ≤ luminance)
  and leave camera pixels without light; below 1 there is no difference. Here, τ₁ = 1 means one connection per block. A
  camera pixel with connections therefore always keeps one.
- Cut-off projector pixels are searched once, after all camera pixels. Their strongest connection is the strongest
  original one, and each is treated separately, so order does not matter.
- The energy fit comes last, so reinserted connections enter it with their original weight.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.maps.products import kept
from counterlight.maps.row_map import SparseRows
from counterlight.tools.clusters.components import find_clusters
from counterlight.tools.clusters.connections import Connections, connections_of, fit_composition, strongest_of_block


@dataclass(frozen=True)
class Parameters:
    """Parameters of a cut.

    radius : radius of a neighbourhood in projector pixels; 0 or τ₁ = 0 cuts nothing. Thesis: 1 to 15.
    tau_1 : connections of at most this fraction of their block's strongest are removed, 0..1; 1 leaves the strongest.
    tau_2 : a cut-off projector pixel gets back connections of at least this fraction of its strongest, 0..1.
    """

    radius: float
    tau_1: float
    tau_2: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.radius < math.inf:
            raise InputError(f"--cut {self}: found radius {self.radius:g}, expected 0 or more projector pixels")
        for name, value in (("TAU_1", self.tau_1), ("TAU_2", self.tau_2)):
            if not 0 <= value <= 1:
                raise InputError(f"--cut {self}: found {name} {value:g}, expected a fraction from 0 to 1")

    def __str__(self) -> str:
        return f"{self.radius:g} {self.tau_1:g} {self.tau_2:g}"


@dataclass(frozen=True)
class Report:
    """The outcome of a decomposition: connections before and after, and clusters.

    saved_pixels : projector pixels that τ₂ reconnected.
    largest_cluster : size in projector pixels.
    """

    connections_before: int
    connections_after: int
    saved_pixels: int
    largest_cluster: int
    clusters: int


@dataclass(frozen=True)
class Decomposition:
    """T with fewer connections, float32, and the report."""

    near: SparseRows
    report: Report


def decompose(
    near: SparseRows, camera_shape: tuple[int, int], projector_shape: tuple[int, int], parameters: Parameters
) -> Decomposition:
    """Cut the clusters of T (thesis Appendix A) and fit the energy (4.2.3).

    near : T, (camera pixels, projector pixels), float32, ≥ 0. Only camera pixels that count may have entries. Entries
        of other pixels would join clusters, and τ₂ would reconnect unseen projector pixels.
    camera_shape, projector_shape : (height, width).

    Raises InputError if T has another size, or entries that are negative or not finite.
    """
    graph = connections_of(near, camera_shape, projector_shape)
    strongest = strongest_of_block(graph, by_strength(graph), projector_shape, parameters.radius)
    return decomposed(graph, *cut(graph, strongest, parameters.tau_1, parameters.tau_2))


def by_strength(graph: Connections) -> IntArray:
    """Return connections sorted by camera pixel, strongest first, equal ones by projector pixel."""
    return np.asarray(_by_strength(graph.ends, graph.luminance))


@kept(parallel=True)
def _by_strength(ends: IntArray, luminance: FloatArray) -> IntArray:
    order = np.empty(luminance.size, np.int64)
    for pixel in numba.prange(ends.size):
        start = ends[pixel - 1] if pixel else 0
        strongest_first = np.argsort(-luminance[start : ends[pixel]], kind="mergesort")
        for i in range(strongest_first.size):  # a slice takes Numba longer to compile
            order[start + i] = start + strongest_first[i]
    return order


def cut(graph: Connections, strongest: IntArray, tau_1: float, tau_2: float) -> tuple[BoolArray, int]:
    """Apply RemoveLowerConnections and ReinsertHigherConnections of Appendix A.

    strongest : from `strongest_of_block`.

    Returns the connections that stay, (connections,) bool, and the number of projector pixels that τ₂ reconnected.
    """
    keep = graph.luminance > tau_1 * graph.luminance[strongest]
    keep[strongest] = True
    connected = np.bincount(graph.projector[keep], minlength=graph.shape[1]) > 0
    of_cut_off = np.flatnonzero(~connected[graph.projector])
    projector, luminance = graph.projector[of_cut_off], graph.luminance[of_cut_off]
    highest = np.zeros(graph.shape[1])
    np.maximum.at(highest, projector, luminance)
    keep[of_cut_off[luminance >= tau_2 * highest[projector]]] = True
    return keep, int(np.count_nonzero(highest))


def decomposed(graph: Connections, keep: BoolArray, saved_pixels: int) -> Decomposition:
    """Return the kept connections with fitted energy, and their report."""
    clusters = find_clusters(graph.pattern(keep))
    largest = int(clusters.projector_sizes.max(initial=0))
    report = Report(keep.size, int(np.count_nonzero(keep)), saved_pixels, largest, clusters.count)
    return Decomposition(graph.rows(keep, fit_composition(graph, keep)), report)
