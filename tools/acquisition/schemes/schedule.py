"""Find projector blocks that may be lit together: the conflict graph and its colouring (Sen et al. 2005, section 5).

Two blocks conflict if some camera pixel sees both. Blocks of one colour never conflict, so each camera pixel's light
has only one possible source. Each colour becomes patterns, so fewer colours mean fewer pictures.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import IntArray
from counterlight.maps.products import kept
from counterlight.tools.transport.transport import Csr

UNCOLOURED = -1
RECOLOURINGS = 8  # rounds of iterated greedy; in simulated rooms, more rounds remove no further colour
CHUNK_PAIRS = 1 << 25  # pairs of blocks formed at a time


def conflict_graph(camera: NDArray[np.integer], block: NDArray[np.integer], blocks: int) -> Csr:
    """Returns the adjacency (blocks, blocks) of blocks that share a camera pixel, without the diagonal.

    camera, block : (entries,). Camera pixel `camera[i]` sees block `block[i]`.

    The graph is the sum of the camera pixels' cliques, SᵀS, computed in slices of bounded memory.
    """
    order = np.argsort(camera, kind="stable")
    camera, block = camera[order], block[order]
    lengths = np.bincount(camera, minlength=int(camera.max(initial=-1)) + 1).astype(np.int64)
    pairs = np.concatenate([[0], np.cumsum(lengths**2)])
    starts = np.concatenate([[0], np.cumsum(lengths)])
    graph: Csr = sparse.csr_array((blocks, blocks), dtype=np.bool_)
    first = 0
    while first < lengths.size:
        last = max(first + 1, int(np.searchsorted(pairs, pairs[first] + CHUNK_PAIRS, side="right")) - 1)
        rows, columns = camera[starts[first] : starts[last]] - first, block[starts[first] : starts[last]]
        seen = sparse.csr_array((np.ones(rows.size, np.bool_), (rows, columns)), shape=(last - first, blocks))
        graph = sparse.csr_array(graph + seen.T @ seen)
        first = last
    graph.setdiag(0)
    graph.eliminate_zeros()
    return graph


def colour_graph(graph: Csr) -> IntArray:
    """Colour the nodes 0, 1, … such that neighbours differ; colour 0 is the most frequent.

    First fit runs in two orders, and the better result is kept: row by row, which finds the regular tilings that a
    plain wall allows, and by degree. Then follows iterated greedy (Culberson 1992): recolouring whole colour classes in
    another order never needs more colours and often fewer.
    """
    degree = np.diff(graph.indptr)
    shuffled = np.random.default_rng(0).permutation(degree.size)
    tries = [_first_fit(graph, order) for order in (np.arange(degree.size), np.lexsort((shuffled, -degree)))]
    colours = min(tries, key=lambda found: found.max(initial=UNCOLOURED))
    rng = np.random.default_rng(1)
    for _ in range(RECOLOURINGS):
        classes = [np.flatnonzero(colours == c) for c in rng.permutation(colours.max(initial=-1) + 1)]
        classes.sort(key=lambda nodes: -nodes.size)
        if rng.random() < 0.5:
            classes.reverse()
        colours = _first_fit(graph, np.concatenate([*classes, np.zeros(0, np.int64)]))
    frequency = np.bincount(colours)
    rank = np.empty_like(frequency)
    rank[np.argsort(-frequency, kind="stable")] = np.arange(frequency.size)
    return np.asarray(rank[colours], np.int64)


def _first_fit(graph: Csr, order: IntArray) -> IntArray:
    """Give each node in turn the least colour that no neighbour has."""
    colours = np.full(order.size, UNCOLOURED, np.int64)
    _fit_first(graph.indptr, graph.indices, order, colours)
    return colours


@kept()
def _fit_first(indptr: NDArray[np.integer], indices: NDArray[np.integer], order: IntArray, colours: IntArray) -> None:
    # for each colour, the last node that has a neighbour of this colour
    taken_by = np.full(order.size + 1, UNCOLOURED, np.int64)
    for node in order:
        for k in range(indptr[node], indptr[node + 1]):
            if colours[indices[k]] != UNCOLOURED:
                taken_by[colours[indices[k]]] = node
        free = 0
        while taken_by[free] == node:
            free += 1
        colours[node] = free
