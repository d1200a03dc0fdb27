"""Gains of captures by a camera whose brightness wanders: how far they spread, and their removal."""

import numpy as np
import pytest

from counterlight.arrays import FloatArray
from counterlight.tools.acquisition.acquire import Acquisition, acquire
from counterlight.tools.acquisition.averaging import Aim
from counterlight.tools.acquisition.cameras.camera import Shot
from counterlight.tools.acquisition.cameras.simulated import SimulatedCamera
from counterlight.tools.acquisition.few.acquire import acquire_pictures
from counterlight.tools.acquisition.plan import Noise, Picture, Reference
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme
from counterlight.tools.acquisition.store import MemoryStore
from counterlight.tools.acquisition.wander import wander_of
from counterlight.tools.transport.transport import Transport
from tests import test_pictures_first as few
from tests.acquired_rooms import LINEAR, NOISY, error, room_of, sharp_wall

SPREAD = 0.025
SHAPE = 24, 32


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(14)


class WanderingCamera(SimulatedCamera):
    """Multiplies each channel of each capture with a gain of its own."""

    def capture(self, number: int, pattern: Picture) -> list[Shot]:
        gains = 1 + SPREAD * np.random.default_rng(number).normal(size=3).clip(-2, 2)
        return [
            np.rint(np.clip(shot * gains, 0, 65535)).astype(shot.dtype) for shot in super().capture(number, pattern)
        ]


def view(rng: np.random.Generator, glow: float) -> tuple[FloatArray, FloatArray]:
    """Return black and light of white; a quarter of the view gets only a glow, which falls off."""
    light = rng.uniform(0.2, 0.8, (*SHAPE, 3))
    light[:, :8] = glow * np.linspace(0, 1, 8)[:, None]
    return rng.uniform(0.01, 0.02, (*SHAPE, 3)), light


def captures(
    rng: np.random.Generator, picture: FloatArray, spread: float = SPREAD
) -> tuple[list[FloatArray], FloatArray]:
    gains = 1 + spread * rng.normal(size=(16, 3))
    return [gain * picture + rng.normal(0, 1e-4, picture.shape) for gain in gains], gains


def reference(black: list[FloatArray], white: list[FloatArray]) -> Reference:
    noise = Noise(np.full(3, 1e-4), np.zeros(3))
    return Reference(np.mean(black, axis=0), np.mean(white, axis=0), noise, np.zeros(SHAPE, np.bool_), 16)


@pytest.mark.parametrize("glow", [0.0, 0.02])
def test_the_border_tells_the_gains_of_full_pictures_even_with_a_halo(rng: np.random.Generator, glow: float) -> None:
    e, light = view(rng, glow)
    black, (white, gains) = captures(rng, e)[0], captures(rng, e + light)
    wander = wander_of(reference(black, white), black, white)
    assert wander.spread == pytest.approx(gains.std(axis=0, ddof=1), rel=0.05)
    assert wander.is_worth_a_line
    grey, _ = captures(rng, e + 0.3 * light)
    levels = [np.mean(each, axis=(1, 2)) for each in (grey, list(wander.steadied(grey)))]
    before, after = (level.std(axis=0) / level.mean(axis=0) for level in levels)
    assert before.min() > 0.015
    # 192 pixels of 0.015 with noise of 1e-4 determine a gain to 0.05 %
    assert after.max() < 0.001
    true = np.mean(e + 0.3 * light, axis=(0, 1))
    assert levels[1].mean(axis=0) == pytest.approx(true, rel=0.02)  # gains of black and white, 16 captures each


def test_a_steady_camera_is_left_alone(rng: np.random.Generator) -> None:
    e, light = view(rng, 0.0)
    black, white = captures(rng, e, 0.001)[0], captures(rng, e + light, 0.001)[0]
    room = reference(black, white)
    wander = wander_of(room, black, white)
    assert not wander.is_active
    assert wander.room is room
    np.testing.assert_array_equal(wander.steadied(white)[3], white[3])


def test_the_transport_of_a_wandering_camera_is_that_of_a_steady_one(rng: np.random.Generator) -> None:
    truth = sharp_wall(rng)
    steady, wandering = (done(truth, camera) for camera in (SimulatedCamera, WanderingCamera))
    assert wandering.wander is not None
    assert wandering.wander.spread.max() == pytest.approx(SPREAD, rel=0.4)  # deviation of 16 gains
    assert wandering.exposures < 1.2 * steady.exposures
    found, best = (error(each.measured.transport, truth) for each in (wandering, steady))
    assert found < best + 0.008  # the mean gain of 16 captures of white is unknown, to 0.6 %
    assert wandering.check.excess < 0.005


def test_pictures_that_are_captured_once_are_divided_by_the_gains_of_the_border(rng: np.random.Generator) -> None:
    shape = *few.CAMERA, 3
    lit = np.ones(shape[:2])
    lit[:, :6] = 0
    room = few.room_of(few.wall(rng).scaled(lit.ravel()))
    errors = []
    for camera in (SimulatedCamera, WanderingCamera):
        eye = camera(room, NOISY)
        (found,) = acquire_pictures(eye, MemoryStore(eye.exposures), 24, [few.PROJECTOR], LINEAR)
        errors.append(error(found.measured.transport, room.transport))
        assert found.wander is not None
        assert found.wander.is_active == (camera is WanderingCamera)
    assert found.wander.spread == pytest.approx([SPREAD] * 3, rel=0.4)  # deviation of 24 gains, with noise of 0.6 %
    assert errors[1] < 1.3 * errors[0]  # the ratio is 2.2 without this division


def done(truth: Transport, camera: type[SimulatedCamera]) -> Acquisition:
    room = room_of(truth)
    eye = camera(room, NOISY)
    store = MemoryStore(eye.exposures, averaged=True)
    return acquire(eye, store, HierarchicalScheme(), room.projectors, None, Aim(seconds=1e5))[0]
