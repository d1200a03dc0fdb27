"""Linear cameras pass. Other cameras stop with advice, for every file type."""

import numpy as np
import pytest
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.acquisition.cameras.camera import Exposures
from counterlight.tools.acquisition.few.acquire import acquire_pictures
from counterlight.tools.acquisition.linearity import bend_of, halves_of
from counterlight.tools.acquisition.plan import REPEATS, Noise, Reference
from counterlight.tools.acquisition.store import MemoryStore
from tests.rig.files import Stored
from tests.rig.rig import Devices, Rig
from tests.rig.sensor import Sensor
from tests.small_rigs import small_room
from tests.studies.linearity import measured
from tests.studies.noise import RigCamera

LINEAR = Stored(bits=16), Stored(), Stored(quality=92)
BENT = (
    Stored("srgb", quality=92), Stored("srgb"), Stored("srgb", bits=16), Stored("srgb, then S", quality=92),
    Stored("S"), Stored("weak S", quality=92), Stored(1.3, quality=92), Stored(1 / 1.3),
)  # fmt: skip


def storing(stored: Stored) -> RigCamera:
    """Return the rig's camera, which stores its captures as `stored` does."""
    return RigCamera(Rig(small_room("wall"), Devices(stored=stored)))


def rig_of(room: str, electrons: float = 20000.0, black: float = 0.01) -> Rig:
    return Rig(small_room(room), Devices(sensor=Sensor(full_well=electrons), room_light=black))


@pytest.mark.parametrize("room", ["wall", "corner", "glass", "defocus"])
@pytest.mark.parametrize("electrons", [20000.0, 2000.0])
def test_curves_are_distinguished_from_noise_and_from_few_bits(room: str, electrons: float) -> None:
    rig = rig_of(room, electrons)
    for stored in LINEAR:
        bend = measured(rig, stored)
        assert bend is not None
        assert bend.is_linear, (stored, bend)
        assert abs(bend.amount) < 0.03, (stored, bend)
    for stored in BENT:
        bend = measured(rig, stored)
        assert bend is not None
        assert not bend.is_linear, (stored, bend)


def test_a_curve_that_is_given_is_none() -> None:
    rig = rig_of("wall", black=0.1)
    for stored, response in ((Stored("srgb", quality=92), Response("srgb")), (Stored(1.8), Response("gamma", 1.8))):
        bend = measured(rig, stored, Exposures(response=response))
        assert bend is not None
        assert bend.is_linear
        wrong = measured(rig, Stored(quality=92), Exposures(response=response))
        assert wrong is not None
        assert not wrong.is_linear
        assert "--camera-response is not the camera's curve" in wrong.described(response)


def mixing_room(rng: np.random.Generator) -> tuple[Reference, NDArray[np.float64], NDArray[np.float64]]:
    """Return a room without noise, and a linear camera's captures of a picture and its complement."""
    white, share = rng.uniform(0.3, 0.9, (30, 40, 3)), rng.uniform(0, 1, (30, 40, 1))
    noise = Noise(np.full(3, 1e-4), np.zeros(3))
    room = Reference(np.zeros_like(white), white, noise, np.zeros(white.shape[:2], np.bool_), REPEATS)
    return room, share * white, (1 - share) * white


def test_what_else_does_not_add_up_is_not_taken_for_a_curve(rng: np.random.Generator) -> None:
    room, picture, complement = mixing_room(rng)
    elsewhere = picture.reshape(-1, 3)[rng.permutation(picture.size // 3)].reshape(picture.shape)
    for seen in (
        (picture, complement),
        (1.2 * picture, 1.2 * complement),  # the lamp is brighter for dark pictures
        (1.1 * picture, complement),  # the exposure changes between the two
        (picture + 0.05, complement + 0.05),  # light from elsewhere in the room
        (room.floodlight, complement),  # the camera still sees the previous picture
        (0 * picture, picture),
        (picture, elsewhere),  # the camera has moved far
    ):
        bend = bend_of(room, *seen)
        assert bend is not None
        assert bend.is_linear, bend
    assert bend_of(room, picture, picture * 0 + room.floodlight / 2) is not None


def test_where_no_camera_pixel_sees_both_pictures_nothing_is_said(rng: np.random.Generator) -> None:
    room, picture, _ = mixing_room(rng)
    lit = rng.random(picture.shape[:2])[..., None] < 0.5
    seen = np.where(lit, room.floodlight, 0), np.where(lit, 0, room.floodlight)
    assert bend_of(room, *seen) is None
    dark = Reference(room.black, room.floodlight, Noise(np.full(3, 0.1), np.zeros(3)), room.saturated, REPEATS)
    assert bend_of(dark, *seen) is None  # the noise is as large as any signal


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (21, 30), (72, 96), (216, 384)])
def test_half_of_the_picture_is_lit_in_cells_of_all_sizes(shape: tuple[int, int]) -> None:
    lit = halves_of(shape)
    assert abs(lit.mean() - 0.5) <= 0.5 / lit.size + 1e-9 or lit.size == 1
    if min(shape) > 60:
        changes = [np.mean(lit[:, step:] != lit[:, :-step]) for step in (1, 8, 60)]
        assert 0.1 < changes[0] < changes[1] < changes[2] < 0.6


def test_pictures_first_stop_as_well() -> None:
    linear, bent = storing(Stored()), storing(Stored("S"))
    acquire_pictures(linear, MemoryStore(linear.exposures), 14, [linear.raster])
    with pytest.raises(InputError, match="light does not add up in the captures: half and half"):
        acquire_pictures(bent, MemoryStore(bent.exposures), 14, [bent.raster])
