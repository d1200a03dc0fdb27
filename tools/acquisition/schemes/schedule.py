"""Which projector blocks may be lit together: the conflict graph and its colouring (Sen et al. 2005, section 5).

Two blocks conflict if some camera pixel sees both. Blocks of one colour never do, so that each camera pixel's light has
one possible source. Colours become patterns, so few colours are what matters.
"""

import numpy as np
from scipy import sparse

from counterlight.arrays import IntArray
from counterlight.tools.transport.transport import Csr

UNCOLOURED = -1
RECOLOURINGS = 8  # rounds of iterated greedy; on simulated rooms later ones remove no further colour
WORD = 62  # colours a 64-bit word holds, clear of its sign
FULL_WORD = (1 << WORD) - 1
CHUNK_PAIRS = 1 << 25  # pairs of blocks formed at a time


def conflict_graph(camera: IntArray, block: IntArray, blocks: int) -> Csr:
    """Adjacency (blocks, blocks) of blocks that share a camera pixel, without the diagonal; the values mean nothing.

    camera, block : (entries,), camera pixel `camera[i]` sees block `block[i]`.
    The graph is the sum over camera pixels of their cliques, SᵀS, made in slices of bounded memory.
    """
    order = np.argsort(camera, kind="stable")
    camera, block = camera[order], block[order]
    lengths = np.bincount(camera, minlength=int(camera.max(initial=-1)) + 1).astype(np.int64)
    pairs = np.concatenate([[0], np.cumsum(lengths**2)])
    starts = np.concatenate([[0], np.cumsum(lengths)])
    graph: Csr = sparse.csr_array((np.zeros(0, np.int32), (camera[:0], block[:0])), shape=(blocks, blocks))
    first = 0
    while first < lengths.size:
        last = max(first + 1, int(np.searchsorted(pairs, pairs[first] + CHUNK_PAIRS, side="right")) - 1)
        rows, columns = camera[starts[first] : starts[last]] - first, block[starts[first] : starts[last]]
        seen = sparse.csr_array((np.ones(rows.size, np.int32), (rows, columns)), shape=(last - first, blocks))
        graph = sparse.csr_array(graph + seen.T @ seen)
        graph.data = np.ones(graph.nnz, np.int32)
        first = last
    graph.setdiag(0)
    graph.eliminate_zeros()
    return graph


def colour_graph(graph: Csr) -> IntArray:
    """A colour 0, 1, … for each node, never that of a neighbour; colour 0 is the most frequent.

    First fit in two orders, of which the better is kept: row by row, which finds the regular tilings that a plain wall
    allows, and by degree. Then iterated greedy (Culberson 1992): recolouring whole colour classes one after the other,
    in another order, never needs more colours and often fewer; a class's nodes do not touch, so they are done at once.
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
        recoloured = np.full_like(colours, UNCOLOURED)
        for nodes in classes:
            recoloured[nodes] = _least_free_colour(graph, nodes, recoloured)
        colours = recoloured
    frequency = np.bincount(colours)
    rank = np.empty_like(frequency)
    rank[np.argsort(-frequency, kind="stable")] = np.arange(frequency.size)
    return np.asarray(rank[colours], np.int64)


def _first_fit(graph: Csr, order: IntArray) -> IntArray:
    """Greedy colouring in a given order. Node by node: neighbours wait for each other, so arrays would not help."""
    own = [0] * order.size  # 1 << colour, 0 without one
    for node in order.tolist():
        taken = 0
        for neighbour in graph.indices[graph.indptr[node] : graph.indptr[node + 1]].tolist():
            taken |= own[neighbour]
        own[node] = ~taken & (taken + 1)  # the lowest bit that is not held
    return np.array([bit.bit_length() - 1 for bit in own], np.int64)


def _least_free_colour(graph: Csr, nodes: IntArray, colours: IntArray) -> IntArray:
    """For each node the least colour that no neighbour has; sets of colours are the bits of words."""
    rows, neighbours = _neighbours(graph, nodes)
    taken = colours[neighbours]
    least = np.full(nodes.size, UNCOLOURED, np.int64)
    for word in range(int(taken.max(initial=UNCOLOURED)) // WORD + 2):
        bits = np.where(taken // WORD == word, np.int64(1) << (taken % WORD), 0)
        held = np.zeros(nodes.size, np.int64)
        if rows.size:
            starts = np.flatnonzero(np.diff(rows, prepend=-1))  # rows come in order
            held[rows[starts]] = np.bitwise_or.reduceat(bits, starts)
        free = ~held & (held + 1)  # the lowest bit that is not held
        found = (least == UNCOLOURED) & (held < FULL_WORD)
        least[found] = word * WORD + np.log2(free[found]).astype(np.int64)
    return least


def _neighbours(graph: Csr, nodes: IntArray) -> tuple[IntArray, IntArray]:
    """(position in `nodes`, neighbour) of every link that leaves `nodes`."""
    lengths = (graph.indptr[nodes + 1] - graph.indptr[nodes]).astype(np.int64)
    rows = np.repeat(np.arange(nodes.size), lengths)
    offset = np.repeat(graph.indptr[nodes] - np.concatenate([[0], np.cumsum(lengths)[:-1]]), lengths)
    return rows, graph.indices[np.arange(rows.size) + offset].astype(np.int64)
