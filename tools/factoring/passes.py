"""Loops over T's entries, compiled by Numba: each reads T once, row by row, and stores nothing of its size.

T's rows are (indptr, indices, weights) of SparseRows: `rows` rows over n columns. The model of far light consists of
the node weights of both sides, the textures F (rows, 3) and G (n, 3), and the mix M (camera nodes, projector nodes, 3).
Sums over rows are computed in parts, each by one thread, which the caller adds in order. They do not depend on the
number of cores. Slices are written as loops, because Numba compiles them in half the time.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.maps.products import kept
from counterlight.maps.row_map import SparseRows

# parts of a pass; fewer for more than WIDE projector pixels, because each part holds a picture
PARTS, WIDE = (16, 4), 1 << 18


@kept()
def _parts(columns):  # type: ignore[no-untyped-def]
    return PARTS[0] if columns <= WIDE else PARTS[1]


@kept()
def _seen_nodes(q, k, corners, weights, F, M):  # type: ignore[no-untyped-def]
    """Write q (projector nodes, 3): row k of diag(F) Φ M."""
    for node in range(q.shape[0]):
        for c in range(3):
            q[node, c] = 0.0
    for i in range(4):
        if weights[k, i] == 0:
            continue
        row = M[corners[k, i]]
        for c in range(3):
            share = weights[k, i] * F[k, c]
            for node in range(q.shape[0]):
                q[node, c] += share * row[node, c]


@kept()
def _at(q, j, c, corners, weights, G):  # type: ignore[no-untyped-def]
    """Returns the model's entry at column j."""
    total = 0.0
    for i in range(4):
        total += weights[j, i] * q[corners[j, i], c]
    return total * G[j, c]


@kept(parallel=True)
def concentrated(indptr, indices, weights, labels, shares, peak, crowd):  # type: ignore[no-untyped-def]
    """Whether entries are too concentrated to be far light, (entries,).

    An entry is concentrated if it is `peak` times its row's mean, or in a block that sends `crowd` times its share.

    labels : (n,). Block of each column.
    shares : (blocks,). Share of the raster's pixels.
    """
    apart = np.zeros(indices.size, np.bool_)
    columns = labels.size
    for k in numba.prange(indptr.size - 1):
        sums, blocks = np.zeros(3), np.zeros(shares.size)
        for e in range(indptr[k], indptr[k + 1]):
            for c in range(3):
                sums[c] += weights[e, c]
                blocks[labels[indices[e]]] += weights[e, c]
        total = sums.sum()
        for e in range(indptr[k], indptr[k + 1]):
            block = labels[indices[e]]
            apart[e] = blocks[block] > crowd * shares[block] * total
            for c in range(3):
                apart[e] |= weights[e, c] * columns > peak * sums[c]
    return apart


@kept(parallel=True)
def projected(  # type: ignore[no-untyped-def]
    indptr, indices, weights, apart, relative, limit, F, G, M, camera, camera_weights, projector, projector_weights
):
    """Returns Aᵀ far B (parts, camera nodes, projector nodes, 3), far·1 (rows, 3) and 1ᵀfar (parts, n, 3), in parts.

    far is T without near entries: the entries `apart`, and entries that exceed the model by more than limit · F / n. If
    `relative`, the model replaces them; otherwise nothing does, and entries are compared with 0 instead of the model.
    """
    rows, columns = indptr.size - 1, G.shape[0]
    parts = _parts(columns)
    sent, seen = np.zeros((parts, columns, 3)), np.zeros((rows, 3))
    mixed = np.zeros((parts, M.shape[0], M.shape[1], 3))
    for b in numba.prange(parts):
        q, gathered, value = np.zeros((M.shape[1], 3)), np.zeros((M.shape[1], 3)), np.zeros(3)
        for k in range(b * rows // parts, (b + 1) * rows // parts):
            if indptr[k] == indptr[k + 1]:
                continue
            for node in range(M.shape[1]):
                for c in range(3):
                    gathered[node, c] = 0.0
            if relative:
                _seen_nodes(q, k, camera, camera_weights, F, M)
            for e in range(indptr[k], indptr[k + 1]):
                j, near = indices[e], apart[e]
                for c in range(3):
                    value[c] = _at(q, j, c, projector, projector_weights, G)
                    near |= weights[e, c] - value[c] > limit * F[k, c] / columns
                for c in range(3):
                    light = min(value[c], weights[e, c]) if near else weights[e, c]
                    seen[k, c] += light
                    sent[b, j, c] += light
                    for i in range(4):
                        gathered[projector[j, i], c] += projector_weights[j, i] * G[j, c] * light
            for i in range(4):
                for c in range(3):
                    share = camera_weights[k, i] * F[k, c]
                    if share != 0:
                        for node in range(M.shape[1]):
                            mixed[b, camera[k, i], node, c] += share * gathered[node, c]
    return mixed, seen, sent


@kept(parallel=True)
def onto_nodes(indptr, indices, weights, cells, F, camera, camera_weights, nodes):  # type: ignore[no-untyped-def]
    """Returns parts of AᵀU of far light that T already has, (parts, camera nodes, cells, 3).

    indptr, indices, weights : rows of U over cells.
    """
    rows, parts = indptr.size - 1, PARTS[1]
    found = np.zeros((parts, nodes, cells, 3))
    for b in numba.prange(parts):
        for k in range(b * rows // parts, (b + 1) * rows // parts):
            for i in range(4):
                node = found[b, camera[k, i]]
                for e in range(indptr[k], indptr[k + 1]):
                    for c in range(3):
                        node[indices[e], c] += camera_weights[k, i] * F[k, c] * weights[e, c]
    return found


@kept(parallel=True)
def missed(  # type: ignore[no-untyped-def]
    indptr,
    indices,
    weights,
    relative,
    limits,
    F,
    G,
    M,
    camera,
    camera_weights,
    projector,
    projector_weights,
    pictures,
    known,
    counted,
):
    """Returns the number of near entries and the errors Σ δ² of pictures if only entries beyond a limit stay near.

    limits : (L,). Ascending limits of (T − model) n / F.
    pictures : (n, 3, Q). The first is all ones, and scaling of rows makes its light exact.
    known : (rows, 3, Q). Light of T outside these entries.
    counted : (rows,) bool.

    Returns parts per limit, (parts, L) and (parts, L, 3, Q).
    """
    rows, columns, levels, count = indptr.size - 1, G.shape[0], limits.size, pictures.shape[2]
    parts = _parts(columns)
    kept, squares = np.zeros((parts, levels), np.int64), np.zeros((parts, levels, 3, count))
    gathered = np.zeros((M.shape[1], 3, count))
    for j in range(columns):
        for i in range(4):
            for c in range(3):
                for u in range(count):
                    gathered[projector[j, i], c, u] += projector_weights[j, i] * G[j, c] * pictures[j, c, u]
    for b in numba.prange(parts):
        q, rest = np.zeros((M.shape[1], 3)), np.zeros(3)
        near, light, left = np.zeros((levels + 1, 3, count)), np.zeros((3, count)), np.zeros((3, count))
        for k in range(b * rows // parts, (b + 1) * rows // parts):
            _seen_nodes(q, k, camera, camera_weights, F, M)
            for c in range(3):
                for u in range(count):
                    light[c, u] = 0.0
                    for level in range(levels + 1):
                        near[level, c, u] = 0.0
                for node in range(M.shape[1]):
                    for u in range(count):
                        light[c, u] += q[node, c] * gathered[node, c, u]
                for u in range(count):
                    left[c, u] = known[k, c, u] - light[c, u]
            for e in range(indptr[k], indptr[k + 1]):
                j, level = indices[e], 0
                for c in range(3):
                    rest[c] = weights[e, c]
                    if relative:
                        rest[c] -= _at(q, j, c, projector, projector_weights, G)
                for c in range(3):
                    while level < levels and rest[c] * columns > limits[level] * F[k, c]:
                        level += 1
                for before in range(level):
                    kept[b, before] += 1
                for c in range(3):
                    for u in range(count):
                        left[c, u] += weights[e, c] * pictures[j, c, u]
                        near[level, c, u] += rest[c] * pictures[j, c, u]
            if not counted[k]:
                continue
            for level in range(levels, 0, -1):
                for c in range(3):
                    for u in range(count):
                        left[c, u] -= near[level, c, u]  # these entries are near light already at the next lower limit
                    fits = left[c, 0] > -light[c, 0] / 2 and left[c, 0] < light[c, 0]
                    scale = left[c, 0] / light[c, 0] if fits else 0.0
                    for u in range(count):
                        squares[b, level - 1, c, u] += (left[c, u] - scale * light[c, u]) ** 2
    return kept, squares


@kept(parallel=True)
def beyond(  # type: ignore[no-untyped-def]
    indptr, indices, weights, relative, limit, F, G, M, camera, camera_weights, projector, projector_weights
):
    """Whether entries exceed the model (0 if not `relative`) by more than limit · F / n, (entries,)."""
    keep = np.zeros(indices.size, np.bool_)
    columns = G.shape[0]
    rows, parts = indptr.size - 1, _parts(G.shape[0])
    for b in numba.prange(parts):
        q = np.zeros((M.shape[1], 3))
        for k in range(b * rows // parts, (b + 1) * rows // parts):
            if relative:
                _seen_nodes(q, k, camera, camera_weights, F, M)
            for e in range(indptr[k], indptr[k + 1]):
                for c in range(3):
                    rest = weights[e, c] - _at(q, indices[e], c, projector, projector_weights, G)
                    keep[e] |= rest * columns > limit * F[k, c]
    return keep


@kept(parallel=True)
def explained(  # type: ignore[no-untyped-def]
    indptr, indices, F, G, M, camera, camera_weights, projector, projector_weights
):
    """Returns the model at entries, (entries, 3)."""
    found = np.zeros((indices.size, 3))
    rows, parts = indptr.size - 1, _parts(G.shape[0])
    for b in numba.prange(parts):
        q = np.zeros((M.shape[1], 3))
        for k in range(b * rows // parts, (b + 1) * rows // parts):
            _seen_nodes(q, k, camera, camera_weights, F, M)
            for e in range(indptr[k], indptr[k + 1]):
                for c in range(3):
                    found[e, c] = _at(q, indices[e], c, projector, projector_weights, G)
    return found


@kept(parallel=True)
def residual_and_back(indptr, indices, weights, pictures, offset, counted):  # type: ignore[no-untyped-def]
    """Returns r = T p + offset of Q pictures, (rows, 3, Q), 0 if not counted, and Tᵀ r in parts, (parts, n, 3, Q)."""
    rows, columns, count = indptr.size - 1, pictures.shape[0], pictures.shape[2]
    parts = _parts(columns)
    residual, back = np.zeros((rows, 3, count)), np.zeros((parts, columns, 3, count))
    for b in numba.prange(parts):
        for k in range(b * rows // parts, (b + 1) * rows // parts):
            if not counted[k]:
                continue
            r = residual[k]
            for c in range(3):
                for u in range(count):
                    r[c, u] = offset[k, c, u]
            for e in range(indptr[k], indptr[k + 1]):
                for c in range(3):
                    for u in range(count):
                        r[c, u] += weights[e, c] * pictures[indices[e], c, u]
            for e in range(indptr[k], indptr[k + 1]):
                for c in range(3):
                    for u in range(count):
                        back[b, indices[e], c, u] += weights[e, c] * r[c, u]
    return residual, back


def operands(rows: SparseRows) -> tuple[NDArray[np.int64], NDArray[np.int32], FloatArray]:
    """Returns indptr, indices and weights with the types that the loops require."""
    return (
        rows.indptr.astype(np.int64, copy=False),
        rows.indices.astype(np.int32, copy=False),
        np.ascontiguousarray(rows.weights),
    )
