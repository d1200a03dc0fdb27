"""Lens distortion, colour filters and flicker, against OpenCV, fluxes and integrals."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from counterlight.errors import InputError
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, simulated_rooms
from counterlight.tools.simulation.devices import MOSAICS, Device, Flicker, Sensor
from counterlight.tools.simulation.effects.colour_filters import interpolated
from counterlight.tools.simulation.effects.distortion import distorted, turning
from counterlight.tools.simulation.effects.flicker import gains
from counterlight.tools.simulation.effects_on import EffectsOn
from counterlight.tools.simulation.needs import needs_of
from counterlight.tools.simulation.projector_side import deposits, irradiance
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from tests.programs import command
from tests.scenes import plane, scene_file, small

FloatArray = NDArray[np.float64]
BARREL = (-0.32, 0.08, 0.004, -0.006, 0.01)
BENT = f"distortion = {list(BARREL)}"
WHITE = "albedo = [1, 1, 1]"


def bent(tmp_path: Path, device: str, surfaces: str = "") -> Scene:
    """Return a white plane before two wide lenses, one of them distorted."""
    scene = load_scene(scene_file(tmp_path, surfaces or plane(extra=WHITE), fov="60"))
    camera = replace(scene.camera, tan_half=(0.7, 0.49))
    scene = replace(scene, camera=camera)
    return replace(scene, **{device: replace(getattr(scene, device), distortion=BARREL)})


def opencv(device: Device) -> tuple[FloatArray, FloatArray]:
    """Return K and the coefficients. OpenCV's (0, 0) is the upper left pixel's centre; our (0, 0) is its corner."""
    fx, fy = device.width / 2 / device.tan_half[0], device.height / 2 / device.tan_half[1]
    K = np.array([[fx, 0, device.width / 2], [0, fy, device.height / 2], [0, 0, 1]])
    return K, np.array(device.distortion)


@pytest.mark.parametrize("device", ["projector", "camera"])
def test_a_lens_bends_as_opencv_says(tmp_path: Path, rng: np.random.Generator, device: str) -> None:
    scene = distorted(bent(tmp_path, device))
    lens = getattr(scene, device)
    places = np.concatenate([rng.uniform(-0.6, 0.6, (200, 2)), np.ones((200, 1))], axis=1)
    K, coefficients = opencv(lens)
    expected, _ = cv2.projectPoints(places, np.zeros(3), np.zeros(3), K, coefficients)
    points = lens.position + places @ np.stack([lens.right, -lens.up, lens.forward])
    found = np.stack(lens.project(points)[:2], axis=1)
    np.testing.assert_allclose(found, expected[:, 0], atol=1e-9)
    across, up = lens.direction_of(*found.T)  # the inverse map, for each direction that the lens shows
    np.testing.assert_allclose(np.stack([across, -up], axis=1), places[:, :2], atol=1e-8)


def test_what_lies_beyond_the_turn_is_not_shown(tmp_path: Path) -> None:
    """Beyond the polynomial's turn, OpenCV shows the same directions a second time. The simulator shows nothing."""
    scene = bent(tmp_path, "camera")
    coefficients = (-0.32, 0.0, 0.0, 0.0, 0.0)
    scene = distorted(replace(scene, camera=replace(scene.camera, tan_half=(0.4, 0.28), distortion=coefficients)))
    assert turning(coefficients) == pytest.approx(np.sqrt(1 / 0.96))
    twice = np.array([[0.0, 0.0, 2.0 - 1.0], [1.75, 0.0, 2.0 - 1.0]])  # x (1 − 0.32 x²) = 0.035 at x = 1.75
    x, y, _ = scene.camera.project(twice)
    assert np.isfinite(x).tolist() == [True, False]
    assert scene.camera.pixel_at(x, y)[1] == -1


def test_a_lens_that_does_not_reach_its_corner_is_refused(tmp_path: Path) -> None:
    scene = bent(tmp_path, "camera")
    folded = replace(scene, camera=replace(scene.camera, distortion=(-0.9, 0.0, 0.0, 0.0, 0.0)))
    with pytest.raises(InputError, match=r"\[camera\], distortion: found .* turns back before the picture's corner"):
        simulate(folded)
    with pytest.raises(InputError, match=r"distortion: found .*, expected 5 numbers from -10 to 10"):
        load_scene(scene_file(tmp_path, plane(), camera="distortion = [0.1, 0.2]"))


def test_a_camera_sees_what_opencv_remaps(tmp_path: Path) -> None:
    """A straight lens's picture, distorted by OpenCV's mapping, equals the view of the distorted lens."""
    scene = replace(bent(tmp_path, "camera"), samples=4)
    y, x = np.mgrid[:12, :16] / 12
    drive = np.repeat((0.5 + 0.3 * np.sin(2 * x) * np.cos(3 * y)).reshape(-1, 1), 3, axis=1)
    seen = simulate(scene).transport.apply(drive).reshape(14, 20, 3)
    fine = replace(scene.camera.resized(400, 500), distortion=(0.0,) * 5, tan_half=(1.0, 0.8))
    picture = simulate(replace(scene, camera=fine, samples=1)).transport.apply(drive).reshape(400, 500, 3)
    K, coefficients = opencv(scene.camera)
    centres = np.stack(np.meshgrid(np.arange(20) + 0.5, np.arange(14) + 0.5), axis=-1).reshape(-1, 1, 2)
    normal = cv2.undistortPoints(centres, K, coefficients)  # OpenCV stops after five iterations
    for _ in range(50):
        ahead = np.concatenate([normal, np.ones((280, 1, 1))], axis=2)
        normal += (centres - cv2.projectPoints(ahead, np.zeros(3), np.zeros(3), K, coefficients)[0]) / K[0, 0]
    normal = normal.reshape(14, 20, 2)
    places = [(normal[..., i] / fine.tan_half[i] + 1) * (500, 400)[i] / 2 - 0.5 for i in range(2)]
    blurred = cv2.blur(picture, (25, 29))  # about one camera pixel of the straight lens
    expected = cv2.remap(blurred, *(place.astype(np.float32) for place in places), cv2.INTER_LINEAR)
    whole = (seen > 0.2).all(axis=-1) & (cv2.erode((expected > 0.2).astype(np.uint8), np.ones((3, 3)))[..., 0] > 0)
    assert whole.sum() > 60
    # the picture has steps of a tenth from projector pixel to projector pixel
    np.testing.assert_allclose(seen[whole], expected[whole], rtol=0.03)


def test_each_projector_pixel_carries_the_same_light(tmp_path: Path) -> None:
    """Where the lens crowds pixels, the wall is brighter.

    Each pixel carries the light that was sent, in both traces.
    """
    scene = bent(tmp_path, "projector")
    scene = replace(scene, camera=replace(scene.camera.resized(400, 480), tan_half=(1.2, 1.0)), samples=2)
    landed = simulate(scene).transport.near
    # on a wall 2 m away
    light = np.bincount(landed.indices, landed.weights[:, 1], landed.columns) * scene.camera.pixel_area * 4
    straight = scene.projector.pixel_area * 4  # a card there has radiance 1: π of irradiance
    # 800 samples per pixel; one line of samples is 3 %. With even irradiance, the corner pixel would have twice the
    # light.
    np.testing.assert_allclose(light, straight, rtol=0.05)
    assert light.reshape(12, 16)[:, [0, -1]].mean() == pytest.approx(straight, rel=0.005)


def test_what_is_traced_forward_lands_where_it_is_seen(tmp_path: Path) -> None:
    """Flux that lands on parts of the wall agrees with the irradiance there. Barrel distortion crowds the corners."""
    scene = bent(tmp_path, "projector")
    scene = distorted(replace(scene, projector=scene.projector.resized(120, 160)))
    edges = np.linspace(-1.2, 1.2, 9)  # metres, on a wall 2 m away
    landed = np.zeros((8, 8))
    for each in deposits(scene, EffectsOn(needs_of(scene))):
        landed += np.histogram2d(*each.point.T[:2], bins=(edges, edges), weights=each.flux[:, 0])[0]
    fine = (np.arange(160) + 0.5) / 160 * 2.4 - 1.2
    points = np.stack([*np.meshgrid(fine, fine, indexing="ij"), np.zeros((160, 160))], axis=-1).reshape(-1, 3)
    shown = scene.projector.pixel_at(*scene.projector.project(points)[:2]).reshape(160, 160) >= 0
    light = irradiance(scene, points, np.tile([0.0, 0.0, 1.0], (len(points), 1))).reshape(160, 160)
    here = light.reshape(8, 20, 8, 20).mean(axis=(1, 3)) * 0.3**2
    whole = shown.reshape(8, 20, 8, 20).all(axis=(1, 3))
    assert whole.sum() >= 20
    assert light[shown].max() > 1.5 * light[shown].min()
    np.testing.assert_allclose(landed[whole], here[whole], rtol=0.02)  # lines of beams at the edges of parts


@pytest.mark.parametrize("mosaic", MOSAICS)
def test_colours_between_filters_are_opencvs(mosaic: str, rng: np.random.Generator) -> None:
    """Interior pixels agree. At the border, OpenCV repeats pixels."""
    picture = rng.integers(0, 60000, (12, 14, 3)).astype(np.uint16)
    sites = np.array(["RGB".index(colour) for colour in mosaic]).reshape(2, 2)
    y, x = np.mgrid[:12, :14]
    raw = np.take_along_axis(picture, sites[y % 2, x % 2][..., None], axis=2)[..., 0]
    second = {"RGGB": "BG", "BGGR": "RG", "GRBG": "GB", "GBRG": "GR"}[mosaic]  # OpenCV names patterns from pixel (1, 1)
    expected = cv2.cvtColor(raw, getattr(cv2, f"COLOR_Bayer{second}2RGB"))
    found = interpolated(mosaic, picture.astype(np.float64))
    np.testing.assert_allclose(found[1:-1, 1:-1], expected[1:-1, 1:-1], atol=1)
    np.testing.assert_allclose(interpolated(mosaic, found), found, rtol=1e-12)
    np.testing.assert_allclose(interpolated(mosaic, np.full((5, 3, 3), 0.7)), 0.7, rtol=1e-12)


def test_filters_are_in_the_transport(rng: np.random.Generator) -> None:
    """The filters act on near and far light, ambient light and the primaries' floodlights."""
    scene = small("corner")
    mixing = np.array([[0.9, 0.1, 0.0], [0.05, 0.9, 0.05], [0.0, 0.1, 0.9]])
    scene = replace(scene, cells=120, camera=replace(scene.camera, mixing=mixing))
    plain, filtered = simulate(scene), simulate(replace(scene, camera=replace(scene.camera, mosaic="GRBG")))
    p = rng.random((scene.projector.pixels, 3))
    expected = interpolated("GRBG", plain.transport.apply(p).reshape(27, 48, 3))
    np.testing.assert_allclose(filtered.transport.apply(p).reshape(27, 48, 3), expected, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(filtered.ambient, interpolated("GRBG", plain.ambient), rtol=1e-5)
    assert plain.spectral is not None
    assert filtered.spectral is not None
    for before, after in zip(plain.spectral.primaries, filtered.spectral.primaries, strict=True):
        np.testing.assert_allclose(after, interpolated("GRBG", before), rtol=1e-5)


def test_a_camera_with_filters_takes_pictures_of_that_transport(tmp_path: Path, rng: np.random.Generator) -> None:
    """Pixels that see a colour have noise. The other pixels have the mean of two or four noisy neighbours."""
    path = scene_file(tmp_path, plane(extra=WHITE), camera='mosaic = "RGGB"')
    scene, codes = load_scene(path), rng.integers(0, 256, (12, 16, 3)).astype(np.uint8)
    found = simulate(scene)
    light = found.transport.apply((codes / 255).reshape(-1, 3)).reshape(14, 20, 3)
    quiet = SimulatedCamera(simulated_rooms(path)[0], CameraSettings(Sensor(0, 0, 16)))
    step = 1.25 * float(found.transport.composition().max()) / (1 << 16)
    np.testing.assert_allclose(quiet.exposures.radiance(quiet.capture(0, codes)), light, atol=step)
    noisy = SimulatedCamera(simulated_rooms(path)[0], CameraSettings(Sensor(20000, 5, 16)))
    white = np.full((12, 16, 3), 255, np.uint8)
    spread = np.std([noisy.exposures.radiance(noisy.capture(i, white))[1:-1, 1:-1] for i in range(100)], axis=0)
    y, x = np.mgrid[1:13, 1:19]
    own, straight, across = (spread[(y % 2 == i) & (x % 2 == j), 0].mean() for i, j in ((0, 0), (0, 1), (1, 1)))
    # 54 pixels of 100 pictures each: 1 %. The mean of two has 1/√2 of the noise, the mean of four has half.
    np.testing.assert_allclose([straight / own, across / own], [np.sqrt(0.5), 0.5], rtol=0.04)


def test_flicker_is_what_an_exposure_sums_up() -> None:
    flicker, sensor = Flicker(0.2, 120.0), Sensor(exposure_s=0.011, readout_s=0.02)
    found = gains(flicker, sensor, 0.5, 8, np.random.default_rng(3))
    phase = np.random.default_rng(3).random() / 120
    for row, gain in enumerate(found):
        middle = phase + 0.02 * row / 8
        light, _ = quad(lambda t: 1 + 0.2 * np.cos(2 * np.pi * 120 * t), middle - 0.00275, middle + 0.00275)
        assert gain == pytest.approx(light / 0.0055, abs=1e-9)
    steady = gains(flicker, replace(sensor, exposure_s=1 / 60), 1.0, 8, np.random.default_rng(3))
    np.testing.assert_allclose(steady, 1, atol=1e-12)  # two whole periods


def test_pictures_flicker_and_t_does_not(tmp_path: Path) -> None:
    light = "flicker = { depth = 0.1, hz = 100 }"
    path = scene_file(tmp_path, plane(extra=WHITE), projector=light)
    room = simulated_rooms(path)[0]
    camera = SimulatedCamera(room, CameraSettings(Sensor(0, 0, 16, exposure_s=0.004)))
    white, expected = np.full((12, 16, 3), 255, np.uint8), room.transport.composition().reshape(14, 20, 3)
    pictures = [camera.exposures.radiance(camera.capture(i, white)) for i in range(200)]
    ratios = np.mean(pictures, axis=(1, 2, 3)) / expected.mean()
    swing = 0.1 * np.sin(0.4 * np.pi) / (0.4 * np.pi)
    assert ratios.std() == pytest.approx(swing / np.sqrt(2), rel=0.1)  # error of 200 random phases
    assert ratios.max() <= 1 + swing + 1e-3
    again = camera.exposures.radiance(camera.capture(7, white))
    np.testing.assert_array_equal(again, pictures[7])  # capture n always has the same phase


def test_acquire_notices_a_projector_that_flickers(tmp_path: Path) -> None:
    """Acquisition warns unless exposures take whole periods. The first measurement detects the flicker."""
    light, room = "flicker = { depth = 0.1, hz = 100 }", tmp_path / "room"
    for seconds, status, pattern in ((0.004, 2, r"error: (flicker|exposure): "), (0.01, 0, r"flicker     good ")):
        sensor = f"sensor = {{ exposure_s = {seconds}, bits = 14 }}"
        path = scene_file(tmp_path, plane(extra=WHITE), projector=light, camera=sensor)
        done = command("acquire", "--camera", f"simulated:{path}", "--shots", "1", "-o", room)
        assert done.returncode == status, done.stderr
        assert re.search(pattern, done.stderr + done.stdout), done.stderr
