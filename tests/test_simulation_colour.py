"""Crosstalk in the simulator, against light computed primary by primary."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.files.picture_files import write_png
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, simulated_rooms
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.simulation.room import simulated_calibration
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import Simulated, simulate
from tests.coloured_rooms import CROSSTALK
from tests.programs import succeed
from tests.scenes import plane, scene_file, small

ROUNDING = 2e-6  # float32 T
MIXING = f"mixing = {CROSSTALK.tolist()}"
OVERLAP = [[1, 0.5, 1], [0.8, 1, 1.4], [1, 0.6, 1]]
PAINT = f"albedo = [0.6, 0.5, 0.4]\noverlap = {OVERLAP}"


def both(scene: Scene) -> tuple[Simulated, Simulated]:
    """Return the room with crosstalk and without."""
    return simulate(scene), simulate(scene, without=["crosstalk"])


def coloured(tmp_path: Path) -> Scene:
    return load_scene(scene_file(tmp_path, plane(extra=PAINT), camera=MIXING, projector="black_level = 0.01"))


def test_channels_see_the_primaries_that_the_scene_says(tmp_path: Path) -> None:
    mixed, plain = both(coloured(tmp_path))
    X = CROSSTALK * OVERLAP
    lit = plain.transport.composition()
    assert mixed.spectral is not None
    F = np.moveaxis(mixed.spectral.primaries.reshape(3, -1, 3), 0, -1)
    np.testing.assert_allclose(F, X * lit[:, None, :], rtol=ROUNDING, atol=1e-9)
    np.testing.assert_allclose(mixed.transport.composition(), lit @ X.T, rtol=ROUNDING, atol=1e-9)
    np.testing.assert_allclose(mixed.ambient, plain.ambient @ X.T, rtol=ROUNDING, atol=1e-9)
    mask = simulated_calibration(coloured(tmp_path), mixed).mask
    assert mask.any()


def test_the_overlap_of_a_paint_is_seen_where_it_is(tmp_path: Path) -> None:
    left = '[[surfaces]]\nname = "left"\ncorner = [-3, -3, 0]\nedge_u = [3, 0, 0]\nedge_v = [0, 6, 0]\n' + PAINT
    right = '[[surfaces]]\nname = "right"\ncorner = [0, -3, 0]\nedge_u = [3, 0, 0]\nedge_v = [0, 6, 0]\n'
    scene = load_scene(scene_file(tmp_path, f"{left}\n{right}albedo = [0.5, 0.5, 0.5]", camera=MIXING))
    spectral = simulate(scene).spectral
    assert spectral is not None
    np.testing.assert_allclose(spectral.mixing[:, :10], np.broadcast_to(CROSSTALK * OVERLAP, (14, 10, 3, 3)))
    np.testing.assert_allclose(spectral.mixing[:, 10:], np.broadcast_to(CROSSTALK, (14, 10, 3, 3)))


def photographed(source: Path, drive: NDArray[np.uint8]) -> NDArray[np.float64]:
    camera = SimulatedCamera(simulated_rooms(source)[0], CameraSettings(Sensor(0, 0, 16)))
    return camera.exposures.radiance(camera.capture(0, drive))


@pytest.mark.parametrize("stored", [False, True])
def test_a_simulated_camera_photographs_colours(tmp_path: Path, rng: np.random.Generator, stored: bool) -> None:
    """A scene is photographed through all nine matrices, a calibration through its floodlights."""
    scene, path = coloured(tmp_path), tmp_path / "scene.toml"
    _, plain = both(scene)
    codes = rng.integers(0, 256, (12, 16, 3)).astype(np.uint8)
    light = plain.transport.apply((codes / 255).reshape(-1, 3)).reshape(14, 20, 3) + plain.ambient
    if stored:
        succeed("simulate", path, "-o", tmp_path / "room")
    found = photographed(tmp_path / "room" if stored else path, codes)
    step = 1.25 * float((plain.transport.composition() @ CROSSTALK.T).max()) * 2 / (1 << 16)
    np.testing.assert_allclose(found, light @ (CROSSTALK * OVERLAP).T, atol=step)  # rounding to 16 bits, and float32 T


def test_far_light_is_mixed_to_its_floodlight() -> None:
    scene = small("corner")
    scene = replace(scene, cells=120, camera=replace(scene.camera, mixing=CROSSTALK))
    mixed, plain = both(scene)
    assert mixed.transport.far is not None
    expected = plain.transport.composition() @ CROSSTALK.T
    np.testing.assert_allclose(mixed.transport.composition(), expected, rtol=ROUNDING, atol=1e-9)


def test_without_crosstalk_nothing_changes(tmp_path: Path) -> None:
    own = load_scene(scene_file(tmp_path, plane(extra=PAINT)))
    _, off = both(coloured(tmp_path))
    found = simulate(own)
    assert found.spectral is None
    assert simulated_calibration(own, found).primaries is None
    assert found.transport.near.weights.tobytes() == off.transport.near.weights.tobytes()


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("mixing = [[1, 0], [0, 1]]", "mixing: found .*, expected a list of 3 lists of 3 numbers"),
        ("mixing = [[1, 0, 0], [1, 0, 0], [0, 0, 1]]", "mixing: found .*, expected three rows, one for each channel"),
        ("mixing = [[1, -0.1, 0], [0, 1, 0], [0, 0, 1]]", "mixing: found .*, expected 3 numbers from 0 to 1"),
    ],
)
def test_a_mixing_that_is_none_is_refused(tmp_path: Path, line: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        load_scene(scene_file(tmp_path, plane(), camera=line))


def test_the_commands_keep_and_say_the_tier(tmp_path: Path) -> None:
    """The calibration from a scene contains the floodlights of the primaries, and playback uses them."""
    path = tmp_path / "scene.toml"
    scene_file(tmp_path, plane(extra=PAINT), camera=MIXING)
    assert "crosstalk         on " in succeed("simulate", path, "-o", tmp_path / "room")
    assert calibration.read(tmp_path / "room").calibration.primaries is not None
    said = succeed("build", tmp_path / "room")
    assert said.startswith("colour: global: one mixing for the room leaves ")
    said = succeed("build", tmp_path / "room", "--colour", "pixel")
    assert said.startswith("colour: pixel: one mixing for the room leaves ")
    picture = tmp_path / "picture.png"
    succeed("relight", tmp_path / "room", "-o", picture)
    said = succeed("play", tmp_path / "room", picture, "--no-config", "--output", tmp_path / "drive.png")
    assert said.startswith("colour: pixel, as the maps were built\nwhite is a camera radiance of ")
    for colour in ("independent", "global", "pixel", "auto"):
        said = succeed("compensate", tmp_path / "room", picture, "--solver", "map,box", "--colour", colour)
        assert said.startswith(f"colour: {'global' if colour == 'auto' else colour}: ")


@pytest.mark.parametrize(("colour", "knows"), [("independent", False), ("pixel", True)])
def test_verify_predicts_colours_if_it_knows_the_primaries(tmp_path: Path, colour: str, knows: bool) -> None:
    """A noise-free 16-bit camera has rounding 100 dB below white."""
    path = scene_file(tmp_path, plane(extra=PAINT), camera=MIXING)
    succeed("simulate", path, "-o", tmp_path / "room")
    y, x = np.mgrid[:14, :20] / 20
    codes = np.rint(255 * np.stack([0.4 + 0.4 * x, 0.8 - 0.6 * y, 0.5 + 0 * x], axis=2)).astype(np.uint8)
    write_png(tmp_path / "picture.png", codes)
    camera = "--camera", f"simulated:{path}", "--bits", "16", "--full-well", "0"
    said = succeed("verify", tmp_path / "room", tmp_path / "picture.png", *camera, "--no-preflight", "--colour", colour)
    assert f"\ncolour: {colour}: " in said
    agrees = re.search(r"agrees with the prediction to ([\d.]+) dB", said)
    assert agrees
    assert (float(agrees[1]) > 80) == knows, said
