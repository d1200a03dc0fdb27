"""Finds parameters that keep every cluster within a given size, from mild to strong (thesis 4.2.2)."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, count

import numpy as np

from counterlight.arrays import BoolArray, IntArray
from counterlight.errors import InputError
from counterlight.maps.row_map import SparseRows
from counterlight.tools.clusters.components import largest_cluster
from counterlight.tools.clusters.connections import Connections, connections_of, strongest_of_block
from counterlight.tools.clusters.decomposition import (
    Decomposition,
    Parameters,
    by_strength,
    cut,
    decomposed,
)

FIRST_RADII = (1, 2, 3, 5, 7, 10, 15)  # first radii to try; figure 4.8 of the thesis shows radii from 3 to 15
WIDER_RADII = 2  # number of radii that are tried beyond the first sufficient radius; they may allow a smaller τ₁
TAU_1_STEPS = 64


@dataclass(frozen=True)
class _Cut:
    """A cut that is small enough: its parameters, the kept connections, and their luminance."""

    parameters: Parameters
    keep: BoolArray
    saved_pixels: int
    light: float


def decompose_to(
    near: SparseRows,
    camera_shape: tuple[int, int],
    projector_shape: tuple[int, int],
    max_cluster: int,
    *,
    or_smallest: bool = False,
) -> tuple[Parameters, Decomposition]:
    """Decompose T so that no cluster has more than `max_cluster` projector pixels; returns the parameters, too.

    A neighbourhood no wider than needed keeps light from elsewhere. Radii therefore grow from 1 until cutting each
    block to its strongest connection (τ₁ = 1) suffices; that radius and the next two are tried. For each radius,
    bisection in steps of 1/64 finds the smallest τ₁ that the size allows. Of the three cuts, the one that keeps the
    most light is returned. Kept light ranks parameters as the camera error does (docs/decomposition.md). τ₂ is always
    1: cut-off pixels get only their strongest connection back. If all clusters are small enough already, T is returned
    uncut (radius 0).

    Because connections are reinserted, sizes are not strictly monotone in τ₁ and radius. The search may therefore miss
    milder parameters; the returned parameters are verified.

    or_smallest : return the smallest clusters found, instead of an error, if no parameters suffice.

    The other arguments and errors are those of `decompose`. Also raises InputError if max_cluster < 1, or below the
    smallest reachable size.
    """
    if max_cluster < 1:
        raise InputError(f"--max-cluster {max_cluster}: expected at least 1 projector pixel")
    graph = connections_of(near, camera_shape, projector_shape)
    everything = np.ones(graph.camera.size, bool)
    if _largest(graph, everything) <= max_cluster:
        return Parameters(0, 0), decomposed(graph, everything, 0)
    best = max(_cuts(graph, projector_shape, max_cluster, or_smallest), key=lambda found: found.light)
    return best.parameters, decomposed(graph, best.keep, best.saved_pixels)


def _cuts(graph: Connections, projector_shape: tuple[int, int], max_cluster: int, or_smallest: bool) -> list[_Cut]:
    """Return the mildest sufficient cut of the first radius that has one, and of the next two.

    If no radius suffices: the closest cut if `or_smallest`, else InputError.
    """
    found: list[_Cut] = []
    smallest, closest = graph.shape[1] + 1, None
    for radius, strongest in _neighbourhoods(graph, projector_shape):
        # a dense T has thousands of blocks of one pixel, so the cut cannot suffice
        if _blocks_of_one(graph, strongest) > max_cluster:
            continue
        size = _largest(graph, cut(graph, strongest, 1.0, 1.0)[0])
        if size < smallest:
            smallest, closest = size, (radius, strongest)
        if size <= max_cluster:
            found.append(_cut(graph, radius, strongest, _smallest_tau_1(graph, strongest, max_cluster)))
        if len(found) > WIDER_RADII:
            break
    if not found and or_smallest and closest is not None:
        return [_cut(graph, *closest, 1.0)]
    if not found:
        raise InputError(
            f"--max-cluster {max_cluster}: the smallest that this transport was cut to has {smallest} projector pixels "
            f"(pixels that only one camera pixel sees stay together); expected at least {smallest}"
        )
    return found


def _cut(graph: Connections, radius: float, strongest: IntArray, tau_1: float) -> _Cut:
    keep, saved_pixels = cut(graph, strongest, tau_1, 1.0)
    return _Cut(Parameters(radius, tau_1), keep, saved_pixels, float(np.sum(graph.luminance[keep])))


def _neighbourhoods(graph: Connections, projector_shape: tuple[int, int]) -> Iterator[tuple[int, IntArray]]:
    """Yield growing radii with each block's strongest connection, until each camera pixel has a single block."""
    order = by_strength(graph)
    camera_pixels = np.count_nonzero(np.bincount(graph.camera))
    previous = 0
    for radius in _radii(projector_shape):
        strongest = strongest_of_block(graph, order, projector_shape, radius)
        blocks = int(np.count_nonzero(strongest == np.arange(strongest.size)))
        if blocks != previous:
            yield radius, strongest
        if blocks == camera_pixels:
            return
        previous = blocks


def _blocks_of_one(graph: Connections, strongest: IntArray) -> int:
    """Return the largest number of blocks of a camera pixel; each block keeps at least one projector pixel."""
    middles = np.flatnonzero(strongest == np.arange(strongest.size))
    return int(np.bincount(graph.camera[middles]).max(initial=0))


def _smallest_tau_1(graph: Connections, strongest: IntArray, max_cluster: int) -> float:
    """Bisect for the smallest sufficient τ₁. τ₁ = 1 is known to suffice, and τ₁ = 0 is known to fail."""
    fails, suffices = 0, TAU_1_STEPS
    while suffices - fails > 1:
        step = (fails + suffices) // 2
        if _largest(graph, cut(graph, strongest, step / TAU_1_STEPS, 1.0)[0]) <= max_cluster:
            suffices = step
        else:
            fails = step
    return suffices / TAU_1_STEPS


def _radii(projector_shape: tuple[int, int]) -> Iterator[int]:
    """Yield growing radii; the last one covers the projector picture."""
    diagonal = math.hypot(*projector_shape)
    for radius in chain(FIRST_RADII, (FIRST_RADII[-1] << i for i in count(1))):
        yield radius
        if radius >= diagonal:
            return


def _largest(graph: Connections, keep: BoolArray) -> int:
    return int(largest_cluster(graph.camera, graph.projector, keep, *graph.shape))
