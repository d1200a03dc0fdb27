"""Certified truncation: no picture within the stated range exceeds the bound, and the worst picture reaches it."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.maps import room_maps as maps
from counterlight.tools.inverse.bidiagonal import largest_singular_value
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.clustered import damped_inverse
from counterlight.tools.inverse.near_light import Inverse, InverseOptions, invert_near_light
from counterlight.tools.inverse.rows import Truncation, entries_to_keep, truncated_piece
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import Csr, channel, channels, stacked
from tests.rooms import blurred_transport, write_blurred_room

FloatArray = NDArray[np.float64]
CAMERA, PROJECTOR = (15, 19), (12, 16)
CHANNELS = range(3)
DAMPING = 0.05
ROUNDING = 1e-12  # float64 sums of a few hundred products below 10


@pytest.fixture
def near(rng: np.random.Generator) -> tuple[Csr, ...]:
    T = blurred_transport(rng, CAMERA, PROJECTOR, 0.8)
    return tuple(sparse.csr_array(T.multiply(rng.uniform(0.5, 1, (T.shape[0], 1)))) for _ in CHANNELS)


@pytest.fixture
def reach(rng: np.random.Generator) -> FloatArray:
    """Returns u: white is 0.5, and a few pixels see brighter ambient light."""
    return np.maximum(0.5, rng.uniform(-1, 1, (CAMERA[0] * CAMERA[1], 3)))


def invert(near: tuple[Csr, ...], reach: FloatArray, max_error: float, damping: float = DAMPING) -> Inverse:
    return invert_near_light(
        stacked(near), np.ones(CAMERA, bool), PROJECTOR, reach, 0.5, InverseOptions(damping, max_error)
    )


def exact_inverses(near: tuple[Csr, ...]) -> list[FloatArray]:
    """T⁺ in float64 by its definition, without dropped entries."""
    inverses = []
    for T in near:
        A = T.toarray().astype(float)
        squared = (DAMPING * largest_singular_value(T)) ** 2
        inverses.append(np.linalg.solve(A.T @ A + squared * np.eye(A.shape[1]), A.T))
    return inverses


def worst_picture(exact: FloatArray, lost: FloatArray, reach: FloatArray) -> FloatArray:
    """Worst picture for a row: b = ± u, by the sign of the lost entry; other entries prevent a clamp of both drives.

    They bring the exact drive to 0.5, or to half of the reachable drive if less.
    """
    dropped = np.abs(lost) > 1e-7 * np.abs(exact).max()
    adverse = np.where(dropped, np.sign(lost) * reach, 0.0)
    kept_light = np.where(dropped, 0.0, np.sign(exact) * reach)
    drive = 0.5 * min(1.0, exact @ kept_light)
    return adverse + (drive - exact @ adverse) / (exact @ kept_light) * kept_light


@pytest.mark.parametrize("max_error", [0.0, 0.1, 0.5, 4.0])
def test_no_picture_in_range_changes_more_than_certified(
    rng: np.random.Generator, near: tuple[Csr, ...], reach: FloatArray, max_error: float
) -> None:
    found = invert(near, reach, max_error)
    assert found.truncation.max() <= max(max_error / 255, 1e-5)  # float32, rows of L1 norm below 50
    matrices = channels(found.T_pinv)
    for colour, exact in enumerate(exact_inverses(near)):
        u, stored = reach[:, colour], matrices[colour].toarray()
        signs = np.sign(exact - stored)
        pictures = [u[:, None] * rng.uniform(-1, 1, (u.size, 50)), u[:, None] * rng.choice([-1, 1], (u.size, 50))]
        pictures.append(signs.T * u[:, None])  # the worst picture of each row
        for b in pictures:
            assert np.all(np.abs(b) <= u[:, None])
            change = np.abs((exact - stored) @ b)
            clamped = np.abs(np.clip(exact @ b, 0, 1) - np.clip(stored @ b, 0, 1))
            bound = found.truncation[:, colour, None] + ROUNDING
            assert np.all(change <= bound)
            assert np.all(clamped <= bound)
            T = near[colour].toarray().astype(float)
            seen = np.abs(T @ (np.clip(exact @ b, 0, 1) - np.clip(stored @ b, 0, 1)))
            assert np.all(seen <= T @ bound)  # T ≥ 0: bound on the camera picture


@pytest.mark.parametrize("max_error", [0.1, 0.5, 4.0])
def test_the_worst_picture_comes_near_the_bound(near: tuple[Csr, ...], reach: FloatArray, max_error: float) -> None:
    found = invert(near, reach, max_error)
    assert found.T_pinv.indices.size < invert(near, reach, 0.0).T_pinv.indices.size
    matrices = channels(found.T_pinv)
    used = []
    for colour, exact in enumerate(exact_inverses(near)):
        stored = matrices[colour].toarray()
        for i in range(0, len(exact), 7):
            u = reach[:, colour]
            b = worst_picture(exact[i], exact[i] - stored[i], u)
            assert np.all(np.abs(b) <= u * (1 + ROUNDING))
            drive, kept = exact[i] @ b, stored[i] @ b
            assert 0 < min(drive, kept) <= max(drive, kept) < 1  # no clamp hides a change
            change = abs(drive - kept)
            assert change <= found.truncation[i, colour] + ROUNDING
            assert change >= found.truncation[i, colour] / 2
            used.append(found.truncation[i].max())
    # the budget is used up to this share, although the channels share one pattern
    assert np.median(used) >= 0.6 * max_error / 255


def test_the_bound_in_camera_radiance_is_reached(rng: np.random.Generator) -> None:
    """Each projector pixel is seen by four camera pixels of its own, so that one picture is the worst for all."""
    weights = rng.uniform(0.05, 1, (60, 4))
    weights[:, 1:] *= 0.05
    camera = np.arange(240)
    near = (sparse.csr_array((weights.ravel().astype(np.float32), (camera, camera // 4)), shape=(240, 60)),) * 3
    reach = np.full((240, 3), 0.02)
    options = InverseOptions(0.001, 4.0)
    found = invert_near_light(stacked(near), np.ones((12, 20), bool), (6, 10), reach, 0.02, options)
    T = near[0].toarray().astype(float)
    sigma = largest_singular_value(near[0])
    exact = damped_inverse(T, np.array(0.001 * sigma))
    stored = channels(found.T_pinv)[0].toarray()
    own = [np.where(row > 0, 0.02, 0.0) for row in exact]
    b = np.sum([worst_picture(a, a - s, u) for a, s, u in zip(exact, stored, own, strict=True)], axis=0)
    assert np.all(np.abs(b) <= 0.02 * (1 + ROUNDING))
    seen = np.abs(T @ (np.clip(exact @ b, 0, 1) - np.clip(stored @ b, 0, 1)))
    bound = T @ found.truncation[:, 0]
    assert np.all(seen <= bound + ROUNDING)
    assert seen.max() >= bound.max() / 2
    assert bound.max() > 0


def test_a_room_keeps_the_bounds_of_its_manifest(tmp_path: Path, rng: np.random.Generator) -> None:
    write_blurred_room(tmp_path / "wall", rng, (18, 25), (15, 20))
    stored = calibration.read(tmp_path / "wall")
    build_room_maps(stored, InverseOptions(DAMPING, 2.0))
    certified = tomllib.loads((tmp_path / "wall" / maps.FOLDER / maps.MANIFEST).read_text())["certified"]
    whole = build_room_maps(stored, InverseOptions(DAMPING, 0.0))
    short = build_room_maps(stored, InverseOptions(DAMPING, 2.0))
    transport = read_transport(stored)
    pixels = stored.calibration.camera.pixels
    pairs = zip(channels(whole.inverse.T_pinv), channels(short.inverse.T_pinv), strict=True)
    white, ambient = short.maps.white, stored.calibration.ambient.reshape(-1, 3).astype(float)
    for i, (exact, kept) in enumerate(pairs):
        c = np.where(rng.integers(0, 2, (pixels, 40)), white, 0.0)  # black and white camera pixels: within the range
        b = c - ambient[:, i, None]
        drives = np.clip(exact @ b, 0, 1), np.clip(kept @ b, 0, 1)
        tolerance = whole.inverse.truncation.max()  # rounding of the whole inverse
        assert np.abs(drives[0] - drives[1]).max() <= certified["truncation_drive"] + tolerance
        seen = np.abs(channel(transport.near, i) @ (drives[0] - drives[1]))
        assert 0 < seen.max() <= certified["truncation_camera_radiance"] + tolerance
    assert certified["truncation_drive"] <= 2 / 255


def test_rounding_to_float32_counts() -> None:
    """With weights of a million that cancel, float32 alone changes the drive, and the bound includes it."""
    weights = 1e6 * np.array([[1 + 1e-8, -1.0, 1e-6]])
    blocks = np.broadcast_to(weights, (3, 1, 1, 3))
    piece = truncated_piece(np.array([[0]]), np.array([[0, 1, 2]]), blocks, Truncation(np.ones((3, 3)), 0.5 / 255))
    lost = weights[0] - piece.weights[:, 0].astype(float)
    assert piece.lengths[0] == 3  # rounding uses the whole budget, so no entry is dropped
    np.testing.assert_allclose(piece.changed[0], np.abs(lost).sum(), rtol=1e-12)
    assert piece.changed[0, 0] > 0.5 / 255


def test_weights_beyond_float32_are_refused() -> None:
    blocks = np.full((3, 1, 2, 1), 1e39)
    with pytest.raises(InputError, match=r"projector pixel 7: its weights.*beyond float32.*about 1e-39"):
        truncated_piece(np.array([[7, 8]]), np.array([[0]]), blocks, Truncation(np.ones((1, 3)), 0.0))


def test_entries_to_keep_drops_the_smallest_first() -> None:
    products = np.array([[0.3, 0.1, 0.2, 0.0], [5.0, 5.0, 5.0, 5.0], [0.1, 0.3, 0.3, 0.3]])
    keep = entries_to_keep(products, 0.5)
    np.testing.assert_array_equal(keep, [[True, False, False, False], [True] * 4, [False, True, True, True]])
    np.testing.assert_array_equal(entries_to_keep(products, np.array([0.7, 21, 0])), [[False] * 4] * 2 + [[True] * 4])
