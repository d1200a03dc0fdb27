"""Direct mapping by triangles: sub-pixel places, and linear interpolation as scipy's between them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.interpolate import LinearNDInterpolator

from counterlight.maps.row_map import SparseRows
from counterlight.tools.inverse.direct import direct_mapping, places, triangulated_mapping
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.transport import Transport

CAMERA, PROJECTOR = (23, 31), (17, 21)  # odd and unequal, so that flips and swaps show
Floats = NDArray[np.float64]


def looked_at() -> Floats:
    """Return the projector position that each camera pixel of an oblique view sees, x and y, (camera pixels, 2)."""
    v, u = np.mgrid[: CAMERA[0], : CAMERA[1]].reshape(2, -1)
    return np.stack([1.2 + 0.61 * u - 0.07 * v, 0.9 + 0.05 * u + 0.58 * v], axis=1)


def seeing(at: Floats, albedo: Floats) -> Transport:
    """Return T of camera pixels that see four projector pixels by bilinear weights.

    The centroid is the exact position.
    """
    (x, y), low = at.T, np.floor(at).astype(int)
    rows, columns, weights = [], [], []
    for dy, dx in np.ndindex(2, 2):
        share = (1 - np.abs(x - low[:, 0] - dx)) * (1 - np.abs(y - low[:, 1] - dy))
        inside = (low[:, 0] + dx < PROJECTOR[1]) & (low[:, 1] + dy < PROJECTOR[0]) & (share > 0)
        rows.append(np.flatnonzero(inside))
        columns.append(((low[:, 1] + dy) * PROJECTOR[1] + low[:, 0] + dx)[inside])
        weights.append((albedo * share)[inside])
    entries = np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))
    T = sparse.csr_array(entries, shape=(len(at), PROJECTOR[0] * PROJECTOR[1]))
    return Transport.from_matrices((T, 0.7 * T, 0.4 * T), camera=CAMERA, projector=PROJECTOR)


def whole(T: Transport, at: Floats) -> NDArray[np.bool_]:
    """Return which camera pixels see four projector pixels inside the raster."""
    return np.asarray(((at >= 0) & (at <= np.array(PROJECTOR[::-1]) - 1)).all(axis=1))


def test_a_place_is_known_to_a_fraction_of_a_pixel(rng: np.random.Generator) -> None:
    at = looked_at()
    T = seeing(at, rng.uniform(0.4, 0.6, len(at)))
    seen, found = places(T.near, PROJECTOR[1])
    known = whole(T, at)[seen]
    assert known.sum() > 400
    np.testing.assert_allclose(found[known], at[seen][known], atol=1e-5)  # float32 entries


def test_light_from_elsewhere_does_not_move_a_place() -> None:
    at = looked_at()
    T = seeing(at, np.ones(len(at)))
    far = sparse.csr_array((np.full(len(at), 0.1), (np.arange(len(at)), np.full(len(at), 2))), shape=T.shape)
    near = T.near
    both = Transport.from_matrices([sparse.csr_array(c + far) for c in scipy_channels(near)], camera=CAMERA)
    away = whole(T, at) & (np.hypot(at[:, 0] - 2, at[:, 1]) > 6)
    seen, found = places(both.near, PROJECTOR[1])
    np.testing.assert_allclose(found[away[seen]], at[seen][away[seen]], atol=1e-5)  # float32 entries


def scipy_channels(rows: SparseRows) -> list[sparse.csr_array]:
    return [sparse.csr_array((w, rows.indices, rows.indptr), shape=rows.shape) for w in rows.weights.T]


def test_between_camera_pixels_it_is_scipys_linear_interpolation(rng: np.random.Generator) -> None:
    at = looked_at()
    T = seeing(at, rng.uniform(0.6, 1.0, len(at)))  # the paints are similar enough to make one surface
    asked = rng.uniform(size=(len(at), 3))
    found = triangulated_mapping(T, CAMERA, PROJECTOR).apply(asked)
    seen, middle = places(T.near, PROJECTOR[1])
    light = T.composition()
    y, x = np.mgrid[: PROJECTOR[0], : PROJECTOR[1]].reshape(2, -1)
    interpolated, floodlit = (LinearNDInterpolator(middle, each[seen])(x, y) for each in (asked, light))
    inner = np.isfinite(interpolated).all(axis=1) & (x > 2) & (y > 2) & (x < PROJECTOR[1] - 2) & (y < PROJECTOR[0] - 2)
    assert inner.sum() > 150
    np.testing.assert_allclose(found[inner], (interpolated / floodlit)[inner], rtol=1e-9)  # float64 on both sides


def test_a_smooth_picture_is_met_better_than_by_whole_pixels() -> None:
    at = looked_at()
    T = seeing(at, np.ones(len(at)))
    y, x = np.mgrid[: PROJECTOR[0], : PROJECTOR[1]].reshape(2, -1)
    drive = np.repeat((0.5 + 0.02 * x - 0.013 * y)[:, None], 3, axis=1)
    errors = [np.abs(prepare(name, T).solve(T.apply(drive)).unclamped - drive) for name in ("direct", "triangulated")]
    inner = (x > 2) & (y > 2) & (x < PROJECTOR[1] - 3) & (y < PROJECTOR[0] - 3)
    assert np.max(errors[1][inner]) < 1e-5  # a plane equals its linear interpolation; float32 entries
    assert np.mean(errors[0][inner]) > 1e-3


def test_across_an_edge_it_is_direct_mapping() -> None:
    at = looked_at()
    right = np.arange(len(at)) % CAMERA[1] >= 16
    apart = at + np.where(right[:, None], [3.0, 0.0], [0.0, 0.0])  # another surface, three pixels further away
    T = seeing(apart, np.where(right, 0.2, 1.0))
    rows = triangulated_mapping(T, CAMERA, PROJECTOR)
    asked = np.where(rows.lengths == 3)[0]
    corners = rows.indices[rows.rows.searchsorted(asked)[:, None] + np.arange(3)] % CAMERA[1] >= 16
    assert np.all(corners.all(axis=1) | ~corners.any(axis=1))
    alone = rows.lengths == 1
    assert alone.any()
    direct = direct_mapping(T.T, T.composition(), np.ones((T.shape[1], 3)))
    np.testing.assert_array_equal(rows.at(np.flatnonzero(alone)).indices, direct.at(np.flatnonzero(alone)).indices)


def test_pixels_on_a_line_have_no_triangles() -> None:
    line = Transport.from_matrices((sparse.csr_array(np.eye(5)),) * 3, camera=(1, 5), projector=(1, 5))
    asked = np.linspace(0.1, 0.9, 15).reshape(5, 3)
    np.testing.assert_allclose(triangulated_mapping(line, (1, 5), (1, 5)).apply(asked), asked)


def test_what_knows_no_sizes_is_refused() -> None:
    line = Transport.from_matrices((sparse.csr_array(np.eye(5)),) * 3)
    with pytest.raises(ValueError, match="sizes of camera and projector"):
        prepare("triangulated", replace(line, camera=(1, 5)))
