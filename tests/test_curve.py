"""The acquisition measures the camera's curve, whatever it is, and leaves linear cameras linear."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools import acquire_transport
from counterlight.tools.acquisition import curve
from counterlight.tools.acquisition.acquire import acquire
from counterlight.tools.acquisition.cameras.camera import LINEAR, Exposures
from counterlight.tools.acquisition.coarse_colour import coloured_like_white
from counterlight.tools.acquisition.curve import CURVE_PICTURES, Curve, curve_of, curve_pictures
from counterlight.tools.acquisition.few.acquire import acquire_pictures
from counterlight.tools.acquisition.linearity import SHOTS
from counterlight.tools.acquisition.plan import REPEATS, Noise, Reference, codes_of
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme
from counterlight.tools.acquisition.store import MemoryStore
from counterlight.tools.transport.transport import Transport, stacked
from tests.rig.files import Stored
from tests.rig.product import photograph_new
from tests.rig.rig import Devices, Rig
from tests.small_rigs import small_room
from tests.studies.noise import RigCamera, error_of

UNKNOWN = Exposures(known=False)
JPEG = Stored("srgb", quality=92)
BENT: dict[str, tuple[Stored, Callable[[NDArray[np.float64]], NDArray[np.float64]]]] = {
    "gamma 1.2": (Stored(1.2), lambda codes: codes**1.2),
    "gamma 3, JPEG": (Stored(3.0, quality=92), lambda codes: codes**3.0),
    "gamma 0.6": (Stored(0.6, bits=16), lambda codes: codes**0.6),
    "sRGB, JPEG": (JPEG, lambda codes: Response("srgb").to_linear(codes)),
    "S": (Stored("S", bits=16), lambda codes: inverted(lambda light: light * light * (3 - 2 * light), codes)),
    "raised black": (Stored("raised"), lambda codes: np.maximum(codes - 0.1, 0) ** 2 / 0.81),
    "logarithm": (Stored("logarithm"), lambda codes: np.expm1(codes * np.log(41)) / 40),
}


def inverted(
    curve: Callable[[NDArray[np.float64]], NDArray[np.float64]], codes: NDArray[np.float64]
) -> NDArray[np.float64]:
    light = np.linspace(0, 1, 4001)
    return np.interp(codes, curve(light), light)


@cache
def measured(stored: Stored, room: str = "wall") -> Curve:
    """Return the curve of a rig's camera, measured from one capture of each picture."""
    rig = Rig(small_room(room), Devices(stored=stored))
    camera, shape = RigCamera(rig, UNKNOWN), rig.raster
    shown = [np.zeros(shape, np.bool_), np.ones(shape, np.bool_), *curve_pictures(shape)]
    shots = [camera.capture(number, picture) for number, picture in enumerate(shown)]
    return curve_of(shots, UNKNOWN, camera.capture(len(shown), shown[1]))


@pytest.mark.parametrize("name", BENT)
def test_any_rising_curve_is_measured(name: str) -> None:
    stored, truth = BENT[name]
    found = measured(stored)
    codes = np.linspace(0.25, 0.9, 40)  # darker codes give less light than the errors below
    light = found.response.to_linear(np.repeat(codes[:, None], 3, axis=1))[:, 1]
    # exposure and black light are unknown, because no picture shows them
    design = np.stack([light, np.ones_like(light)], axis=1)
    scaled = design @ np.linalg.lstsq(design, truth(codes))[0]
    error = (scaled - truth(codes)) / truth(codes).max()
    assert np.sqrt(np.mean(error**2)) < 0.004  # the fit uses 700 camera pixels
    assert np.abs(error).max() < 0.015
    assert found.error < 0.005
    assert not found.is_straight


@pytest.mark.parametrize("name", ["sRGB, JPEG", "raised black"])
def test_black_is_no_light(name: str) -> None:
    stored, truth = BENT[name]
    table, codes = measured(stored).response, np.linspace(0.15, 0.9, 40)
    light = table.to_linear(np.repeat(codes[:, None], 3, axis=1))[:, 1]
    scale = truth(codes) @ light / (light @ light)
    # the room's light, which is 0.9 % of white, is unknown
    np.testing.assert_allclose(scale * light, truth(codes), atol=0.006)


@pytest.mark.parametrize("room", ["wall", "defocus"])
@pytest.mark.parametrize("stored", [Stored(bits=16), Stored(), Stored(quality=92)])
def test_linear_cameras_come_out_linear(room: str, stored: Stored) -> None:
    found = measured(stored, room)
    assert found.response == LINEAR
    assert str(found).startswith(f"{found.files}; linear to 0.")


SHARP = Stored("srgb", sharpening=0.7)


@pytest.mark.parametrize(
    ("stored", "said"),
    [
        (Stored("srgb", bits=16), "more than 8 bits"),
        (Stored("srgb"), "8 bits"),
        (JPEG, "8-bit JPEG, colour at half resolution"),
        (SHARP, "8 bits, sharpened (switch it off, it falsifies the curve)"),
        (
            replace(SHARP, quality=75),
            "8-bit JPEG, colour at half resolution, sharpened (switch it off, it falsifies the curve)",
        ),
        (Stored(2.2, bits=16, smoothing=1.0), "more than 8 bits, noise reduced"),
    ],
)
def test_the_files_of_the_camera_are_described(stored: Stored, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(curve, "measure_curve", lambda *_: Curve(LINEAR, 0.0, 0.0))
    assert str(measured.__wrapped__(stored)).partition(";")[0] == said


def test_a_projector_out_of_sight_gives_no_curve() -> None:
    dark = np.zeros((20, 30, 3), np.uint8)
    with pytest.raises(InputError, match="lights 0 camera pixels well enough to measure the camera's curve"):
        curve_of([(dark,)] * (CURVE_PICTURES + 2), UNKNOWN)


def acquired(stored: Stored) -> tuple[Rig, MemoryStore, float]:
    rig = Rig(small_room("wall"), Devices(stored=stored))
    camera = RigCamera(rig, UNKNOWN)
    store = MemoryStore(camera.exposures)
    (done,) = acquire(camera, store, HierarchicalScheme(), [rig.raster])
    assert done.light
    assert done.coloured
    np.testing.assert_allclose(done.light.gammas, (2.1, 2.2, 2.35), rtol=0.05)
    assert len(done.photographs) == (2 if stored.bits == 8 else 0)
    errors = [
        np.std(np.subtract(*each.lights)) for each in (done.coloured, *done.photographs) if each.lights is not None
    ]
    assert max(errors[1:], default=0) < 0.6 * errors[0]  # JPEG damages random colours more than compensated pictures
    return rig, store, error_of(done.measured.transport, rig)


def test_an_acquisition_reads_all_captures_with_the_curve() -> None:
    _, _, linear = acquired(Stored(bits=16))
    # the bend reveals the curve; the 16 bits of the files do not suggest a curve
    _, _, bent = acquired(Stored("srgb", bits=16))
    assert bent < linear + 0.01  # T of the encoded captures is 30 % off
    rig, store, _ = acquired(JPEG)
    seen, light = store.radiance(1), rig.photograph(codes_of(np.ones(rig.raster, np.bool_)), 1) / 65535
    lit = light > 0.1
    np.testing.assert_allclose(np.median(seen[lit] / light[lit]), seen[lit].sum() / light[lit].sum(), rtol=0.01)


def test_pictures_first_measure_the_curve_in_addition() -> None:
    rig = Rig(small_room("wall"), Devices(stored=Stored("srgb", bits=16)))
    camera = RigCamera(rig, UNKNOWN)
    (done,) = acquire_pictures(camera, MemoryStore(camera.exposures), 14, [rig.raster])
    assert done.curve
    assert not done.curve.is_straight
    assert done.check.error < 0.05  # 1.7 % here; with encoded captures, the acquisition would stop


def test_a_folder_of_jpegs_is_measured_and_keeps_its_captures_if_a_curve_is_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = Rig(small_room("wall"), Devices(stored=JPEG))
    height, width = rig.raster
    words = ["--camera", f"folder:{tmp_path / 'exchange'}", "--projector", f"{width}x{height}", "-o"]
    words += [str(tmp_path / "room")]
    first = 2 * REPEATS + 2 * SHOTS
    for count in (first, CURVE_PICTURES, 108):
        assert acquire_transport.main(words) == 2
        said = capsys.readouterr().err
        assert f"waiting for {count} captures" in said
        assert ("17 more pictures measure it" in said) == (count != first)
        photograph_new(rig, tmp_path / "exchange", 0)
    assert not (tmp_path / "room").exists()
    assert acquire_transport.main([*words, "--camera-response", "1.2"]) == 2
    assert "--camera-response is not the camera's curve" in capsys.readouterr().err
    assert acquire_transport.main([*words, "--camera-response", "srgb"]) == 2
    assert "waiting for" in capsys.readouterr().err
    assert (tmp_path / "exchange" / "patterns" / f"{first + CURVE_PICTURES + 108:05}.png").exists()


def test_rows_get_the_colour_of_white(rng: np.random.Generator) -> None:
    shape = 24, 30
    wall = rng.uniform(0.3, 1, (4, 5, 3)).repeat(6, axis=0).repeat(6, axis=1)
    wall[:, -6:] = 0  # beyond the projector's picture
    pale = np.where(wall > 0, 0.8 * wall + 0.2 * wall.mean(axis=2, keepdims=True), 0)
    noise = Noise(np.full(3, 1e-3), np.zeros(3))
    room = Reference(np.zeros_like(wall), wall, noise, np.zeros(shape, np.bool_), 3)
    T = Transport(stacked([sparse.csr_array(np.diag(row)) for row in pale.reshape(-1, 3).T]))
    found = coloured_like_white(T, room).composition().reshape(wall.shape)
    inside = np.zeros(shape, np.bool_)
    inside[3::6, 3::6] = True  # the middles of the cells, 3σ from other colours
    np.testing.assert_allclose(found[inside], wall[inside], rtol=0.02)  # the tails of the average
    assert np.abs(found - wall).mean() < 0.4 * np.abs(pale - wall).mean()
