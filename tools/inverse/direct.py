"""Direct mapping as rows, to a pixel and to a fraction of a pixel (thesis 6.1).

Each projector pixel uses the one camera pixel that it lights most, or finds the place where the camera sees it. "An
inverse mapping is achieved through triangulation and interpolation": each camera pixel has one place on the projector,
the centre of the light that it sees there. Delaunay triangles connect the places. A projector pixel uses the three
camera pixels of its triangle, with its barycentric weights β:

    p_j = Σ β_k b_k / Σ β_k (T·1)_k

A shader does the same when it samples picture, ambient light and floodlight at one place (SmartProjector, Bimber et al.
2005).
"""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

from counterlight.arrays import FloatArray, IntArray
from counterlight.maps.row_map import SparseRows, below_each_other
from counterlight.tools.transport.objective import FAINTEST
from counterlight.tools.transport.transport import CHANNELS, Shape, Transport, luminance

# projector pixels around the strongest connection; light from further away took another way through the room
REACH = 3.0
NEIGHBOURS = 3.0  # camera pixels; a triangle with corners further apart spans different surfaces
ALIKE = 0.5  # a corner with a smaller share of the brightest corner's light lies beyond an edge


def direct_mapping(dual: Transport, composition: FloatArray, data_share: FloatArray) -> SparseRows:
    """Return rows for p_j = b_i / (T·1)_i at the camera pixel i that projector pixel j lights most, without far light.

    dual : TᵀW, (projector pixels, camera pixels).
    composition : T·1, (camera pixels, 3).
    data_share : (projector pixels, 3). Factor that accounts for the prior, d / (d + η).
    """
    most = lit_most(dual)
    asking = np.flatnonzero(most >= 0)
    light = composition[most[asking]]
    bright = light > FAINTEST * composition.max(axis=0, initial=0.0)
    inverse = np.divide(1.0, light, out=np.zeros(light.shape), where=bright)
    inverse = inverse * data_share[asking]
    starts = np.searchsorted(asking, np.arange(dual.shape[0] + 1))
    return SparseRows(starts, most[asking].astype(np.int32), inverse, dual.shape[1])


def lit_most(dual: Transport) -> IntArray:
    """Return the camera pixel that each projector pixel lights most, or −1: (projector pixels,).

    dual : Tᵀ; its far light is ignored.
    """
    strength, chosen = _largest(dual.near, luminance(dual.near.weights))
    most = np.where(chosen >= 0, np.append(dual.near.indices, -1)[chosen], -1)
    if dual.blurred is None:
        return most
    # A camera pixel sees a projector pixel through one entry or through one cell, never both, so the largest value
    # decides.
    cells, means = dual.blurred.gather, dual.blurred.scatter
    of_cell, entry = _largest(cells, luminance(cells.weights))
    through, cell = _largest(means, luminance(means.weights) * of_cell[means.indices])
    wide = np.append(cells.indices, -1)[entry[np.append(means.indices, 0)[cell]]]
    return np.where(through > strength, wide, most)


def _largest(rows: SparseRows, strength: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return each row's largest strength and the last entry that has it; 0 and −1 for empty rows.

    strength : (entries,).
    """
    at, count = rows.rows, rows.shape[0]
    largest, last = np.zeros(count), np.full(count, -1)
    np.maximum.at(largest, at, strength)
    candidates = np.flatnonzero(strength == largest[at])
    np.maximum.at(last, at[candidates], candidates)
    return largest, last


def triangulated_mapping(T: Transport, camera: Shape, projector: Shape) -> SparseRows:
    """Return the drive per unit of target light, (projector pixels, camera pixels).

    A projector pixel outside all triangles of one surface uses the camera pixel that it lights most, as in
    `direct_mapping`. Blurred light is ignored.

    T : transport of the camera pixels that count.
    camera, projector : (height, width).
    """
    composition = T.composition()
    direct = direct_mapping(T.T, composition, np.ones((T.shape[1], len(CHANNELS))))
    corners, beta = _held(*places(T.near, projector[1]), projector)
    holds = _of_one_surface(corners, luminance(composition), camera[1]) & (beta >= 0).all(axis=1)
    light = np.einsum("jk,jkc->jc", beta[holds], composition[corners[holds]])
    bright = light > FAINTEST * composition.max(axis=0, initial=0.0)
    scale = np.divide(1.0, light, out=np.zeros(light.shape), where=bright)
    weights = beta[holds][:, :, None] * scale[:, None, :]
    asked = corners[holds].astype(np.int32).ravel()
    triangles = SparseRows(3 * np.arange(len(light) + 1), asked, weights.reshape(-1, len(CHANNELS)), T.shape[0])
    place = np.where(holds, np.cumsum(holds) - 1, len(light) + np.arange(holds.size))
    return below_each_other([triangles, direct]).at(place)


def places(near: SparseRows, width: int) -> tuple[IntArray, FloatArray]:
    """Return the centre of the light that each camera pixel sees around its strongest connection.

    near : near light of T.
    width : width of the projector in pixels.

    Returns the seeing camera pixels, (n,), and (n, 2), x and y on the projector.
    """
    light, rows = luminance(near.weights), near.rows
    at = np.stack([near.indices % width, near.indices // width], axis=1).astype(np.float64)
    order = np.lexsort((near.indices, -light, rows))
    seeing, first = np.unique(rows[order], return_index=True)
    strongest = np.zeros((near.shape[0], 2))
    strongest[seeing] = at[order[first]]
    close = np.hypot(*(at - strongest[rows]).T) <= REACH
    weight = np.where(close, light, 0.0)
    sums = np.stack([np.bincount(rows, weight * each, near.shape[0]) for each in (np.ones(len(rows)), *at.T)], axis=1)
    seeing = np.flatnonzero(sums[:, 0] > 0)
    return seeing, sums[seeing, 1:] / sums[seeing, :1]


def _held(seeing: IntArray, at: FloatArray, projector: Shape) -> tuple[IntArray, FloatArray]:
    """Return each projector pixel's triangle of camera pixels, and their weights, (projector pixels, 3) each.

    Weights are −1 outside all triangles.
    """
    y, x = np.mgrid[: projector[0], : projector[1]]
    pixels = np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64)
    try:
        mesh = Delaunay(at)
    except (QhullError, ValueError):  # fewer than three places, or all on a line
        return np.zeros((len(pixels), 3), np.int64), np.full((len(pixels), 3), -1.0)
    triangle = mesh.find_simplex(pixels)
    to_beta = mesh.transform[triangle]
    two = np.einsum("jkl,jl->jk", to_beta[:, :2], pixels - to_beta[:, 2])
    beta = np.concatenate([two, 1 - two.sum(axis=1, keepdims=True)], axis=1)
    held = (triangle >= 0) & np.isfinite(beta).all(axis=1)
    beta = np.clip(beta, 0, 1)  # rounding may put a pixel on an edge outside
    return seeing[mesh.simplices[triangle]], np.where(held[:, None], beta, -1.0)


def _of_one_surface(corners: IntArray, light: FloatArray, width: int) -> NDArray[np.bool_]:
    """Return whether a triangle's camera pixels are neighbours, and see similar amounts of light.

    corners : (projector pixels, 3).
    light : (camera pixels,).
    width : width of the camera in pixels.
    """
    y, x = np.divmod(corners, width)
    close = [np.hypot(x[:, a] - x[:, b], y[:, a] - y[:, b]) <= NEIGHBOURS for a, b in combinations(range(3), 2)]
    seen = light[corners]
    return np.asarray(np.all(close, axis=0) & (seen.min(axis=1) >= ALIKE * seen.max(axis=1)))
