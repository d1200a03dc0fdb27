"""Registration finds known homographies on random transport with noise, and the rotation of a camera."""

import numpy as np
import pytest
from scipy import ndimage, sparse

from counterlight.errors import InputError
from counterlight.pipeline.drift import Moved, resampled
from counterlight.raster import Region
from counterlight.tools.acquisition.camera_shift import camera_shift
from counterlight.tools.acquisition.plan import Noise
from counterlight.tools.acquisition.registration import Registrar, random_field
from counterlight.tools.transport.transport import Transport
from tests.drifted_rooms import moved_by, shifted_boxes
from tests.rooms import blurred_transport

CAMERA, PROJECTOR = (60, 84), (48, 64)
WHOLE = Region(0, 0, 64, 48)
NOISE = Noise(np.full(3, 5 / 20000), np.full(3, 1 / 20000))  # noise of 20 000 electrons
CORNERS = np.array([(0, 0), (64, 0), (64, 48), (0, 48), (32, 24.0)])
EXACT = 0.02  # pixels: 5000 camera pixels, residuals of a few percent, slopes of 0.1 per pixel: 0.004 for a shift
CORNER = 0.04  # eight unknowns, which few pixels at the corners constrain


@pytest.fixture(scope="module")
def transport() -> Transport:
    rng = np.random.default_rng(5)
    blur = blurred_transport(rng, CAMERA, PROJECTOR, 0.5)
    tints = rng.uniform(0.5, 1, (3, blur.shape[0], 1))
    near = [sparse.csr_array(blur.multiply(tint), dtype=np.float32) for tint in tints]
    return Transport.from_matrices(near, camera=CAMERA, projector=PROJECTOR)


def picture() -> np.ndarray:
    return np.repeat(random_field(PROJECTOR)[..., None], 3, axis=2)


def photographed(transport: Transport, arrived: np.ndarray, gain: float = 1.0, seed: int = 0) -> np.ndarray:
    light = gain * transport.apply(arrived.reshape(-1, 3))
    return np.asarray(light + NOISE.sigma(light) * np.random.default_rng(seed).standard_normal(light.shape))


def find(transport: Transport, seen: np.ndarray) -> Moved:
    return Registrar(transport, WHOLE, np.ones(CAMERA, np.bool_)).find(picture(), seen, NOISE).moved


@pytest.mark.parametrize("shift", [(0, 0), (0.8, 0.6), (-0.5, 0.5), (0.25, 0), (-7.3, 4.4), (11, -9)])
def test_a_shift_is_found_again(transport: Transport, shift: tuple[float, float]) -> None:
    """Exact overlaps of pixel boxes give the true picture. The search uses another method."""
    arrived = shifted_boxes(PROJECTOR, shift) @ picture().reshape(-1, 3)
    found = find(transport, photographed(transport, arrived))
    np.testing.assert_allclose(found.displacement(CORNERS), np.tile(shift, (5, 1)), atol=EXACT)


@pytest.mark.parametrize("seed", range(6))
def test_a_homography_is_found_again_and_so_is_the_lamp(transport: Transport, seed: int) -> None:
    """The corners move by up to a few pixels, each differently."""
    rng = np.random.default_rng(seed)
    N = np.eye(3)
    N[:2, :2] += rng.uniform(-0.03, 0.03, (2, 2))
    N[:2, 2], N[2, :2] = rng.uniform(-2, 2, 2), rng.uniform(-5e-4, 5e-4, 2)
    true = Moved(N, np.ones(3))
    seen = photographed(transport, resampled(picture(), np.linalg.inv(N)), 0.87, seed)
    found = find(transport, seen)
    assert np.abs(true.displacement(CORNERS)).max() > 0.5
    np.testing.assert_allclose(found.displacement(CORNERS), true.displacement(CORNERS), atol=CORNER)
    np.testing.assert_allclose(found.gain, 0.87, rtol=2e-3)  # noise of 1 % over 5000 pixels, and the border of T


def test_what_the_data_do_not_hold_is_not_made_up(transport: Transport) -> None:
    """If a camera sees only the left eighth of the picture, the rotation of the right side is unknown."""
    few = np.zeros(CAMERA, np.bool_)
    few[:, :10] = True
    arrived = shifted_boxes(PROJECTOR, (0.8, 0.6)) @ picture().reshape(-1, 3)
    found = Registrar(transport, WHOLE, few).find(picture(), photographed(transport, arrived), NOISE)
    assert found.unknowns == 2
    np.testing.assert_allclose(found.moved.displacement(CORNERS), np.tile((0.8, 0.6), (5, 1)), atol=2 * EXACT)


def test_a_picture_that_nobody_sees_is_said(transport: Transport) -> None:
    with pytest.raises(InputError, match="seen by 0 camera pixels that count, expected 50 or more"):
        Registrar(transport, WHOLE, np.zeros(CAMERA, np.bool_))


def test_a_few_camera_pixels_that_see_something_else_change_nothing(transport: Transport) -> None:
    """A person hides a tenth of the view."""
    arrived = shifted_boxes(PROJECTOR, (0.8, 0.6)) @ picture().reshape(-1, 3)
    seen = photographed(transport, arrived).reshape(*CAMERA, 3)
    seen[20:40, 30:55] = 0.1
    found = find(transport, seen.reshape(-1, 3))
    np.testing.assert_allclose(found.displacement(CORNERS), np.tile((0.8, 0.6), (5, 1)), atol=2 * EXACT)


def test_another_picture_is_not_found(transport: Transport) -> None:
    other = np.repeat(random_field(PROJECTOR, seed=1)[..., None], 3, axis=2)
    registrar = Registrar(transport, WHOLE, np.ones(CAMERA, np.bool_))
    seen = photographed(transport, other)
    assert registrar.find(picture(), seen, NOISE).agreement < 0.7
    assert registrar.find(other, seen, NOISE).agreement > 0.97


@pytest.mark.parametrize("turned", [(0, 0), (0.25, 0), (-0.5, 0.3), (3, -2), (6, 5)])
def test_a_camera_s_turn_is_found_again(turned: tuple[float, float], rng: np.random.Generator) -> None:
    paint = 0.3 + 0.6 * ndimage.zoom(rng.uniform(0, 1, (40, 50)), 3, order=1)  # a patch of paint is 3 pixels wide
    light = np.outer(np.linspace(1, 1.3, 120), np.linspace(1, 0.8, 150))
    x, y = turned
    after = 0.9 * light * ndimage.shift(paint, (-y, -x), order=3, mode="nearest")
    counts = np.zeros(paint.shape, np.bool_)
    counts[10:-10, 10:-10] = True
    before = light * paint + 1e-3 * rng.standard_normal(paint.shape)
    found = camera_shift(before, after, counts)
    # error of two interpolations, for patches of paint of 3 pixels
    np.testing.assert_allclose((found.right, found.down), turned, atol=0.03)
    assert found.unsure < 0.01


def test_bare_paint_tells_nothing_of_the_camera(rng: np.random.Generator) -> None:
    bare = [1 + 1e-2 * rng.standard_normal((60, 80)) for _ in range(2)]
    found = camera_shift(bare[0], bare[1], np.ones((60, 80), np.bool_))
    assert found.explained < 0.6


def test_displacement_is_of_the_picture() -> None:
    np.testing.assert_allclose(moved_by(0.8, 0.6).displacement(CORNERS), np.tile((0.8, 0.6), (5, 1)), atol=1e-12)
