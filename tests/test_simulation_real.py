"""Effects of real rooms: OpenCV, convolutions and the rig's devices judge them, and acquisitions find them."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from counterlight.command import Parser
from counterlight.tools.acquisition.acquire import Acquisition, acquire
from counterlight.tools.acquisition.cameras.simulated import (
    CameraSettings,
    SimulatedCamera,
    SimulatedRoom,
    simulated_rooms,
)
from counterlight.tools.acquisition.rig import open_rig
from counterlight.tools.acquisition.rig_options import add_rig_options
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme
from counterlight.tools.acquisition.store import MemoryStore
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.study.worth import small_room
from counterlight.tools.transport.transport import channels
from tests.acquired_rooms import dense
from tests.rig import projector as rig_projector
from tests.rig import sensor as rig_sensor
from tests.rig.lens import Emission, Lens
from tests.scenes import plane, scene_file, small

FloatArray = NDArray[np.float64]
WHITE = "albedo = [1, 1, 1]"
FRINGES = "lateral_colour = { shift = [[1.1, 0.4], [0, 0], [-0.9, -0.3]], scale = [1.02, 1, 0.97] }"
VIVID = "vividness = [0.25, 0.2, 0.15]\nresponse = 2.2"
HALO = "halo = { share = 0.07, radius_deg = 1.5 }"
LIGHT = np.linspace(0, 1, 1025)
S_CURVE = np.interp(np.linspace(0, 1, 129), LIGHT * (0.5 + 1.5 * LIGHT - LIGHT**2), LIGHT).tolist()  # light of codes


def matching(scene: Scene, margin: int = 0, samples: int = 1) -> Scene:
    """Return the scene with a camera whose pixels are the projector's, and `margin` more on each side."""
    height, width = scene.projector.height + 2 * margin, scene.projector.width + 2 * margin
    tan = tuple(
        half * size / own
        for half, size, own in zip(
            scene.projector.tan_half, (width, height), (scene.projector.width, scene.projector.height), strict=True
        )
    )
    camera = replace(scene.camera, width=width, height=height, tan_half=(tan[0], tan[1]))
    return replace(scene, camera=camera, samples=samples)


def test_lateral_colour_is_opencvs_warp(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path, plane(extra=WHITE), projector=FRINGES)).resized(projector=(60, 80))
    scene = matching(scene, 12, samples=4)
    y, x = np.mgrid[:60, :80] / 60
    drive = 0.5 + 0.4 * np.sin(6 * x + 1) * np.cos(5 * y)
    result = simulate(scene)
    seen = result.transport.apply(np.repeat(drive.reshape(-1, 1), 3, axis=1)).reshape(84, 104, 3)
    width = 80 / 16  # the scene's pixels are five times as wide
    for channel, (right, down, scale) in enumerate([(1.1, 0.4, 1.02), (0, 0, 1), (-0.9, -0.3, 0.97)]):
        # in coordinates of pixel centres
        to_middle = (1 - scale) * np.array([39.5, 29.5]) + width * np.array([right, down]) + 12
        warp = np.array([[scale, 0, to_middle[0]], [0, scale, to_middle[1]]])
        expected = cv2.warpAffine(drive / scale**2, warp, (104, 84), flags=cv2.INTER_CUBIC)
        whole = cv2.erode(cv2.warpAffine(np.ones((60, 80)), warp, (104, 84)), np.ones((5, 5))) == 1
        assert whole.sum() > 3000
        np.testing.assert_allclose(seen[whole, channel], expected[whole], atol=0.02)  # to a quarter of a pixel
        shares = [seen[..., channel].sum(), drive.sum()]
        assert shares[0] == pytest.approx(shares[1], rel=0.01)  # each pixel keeps its flux
    report = {each.need.effect: each for each in result.reports}["lateral_colour"]
    assert report.entries > 0
    assert "up to 6" in report.need.reason


def test_coinciding_primaries_change_nothing(tmp_path: Path) -> None:
    none = "lateral_colour = { shift = [[0, 0], [0, 0], [0, 0]] }"
    one, other = (simulate(load_scene(scene_file(tmp_path, plane(), projector=line))) for line in ("", none))
    for a, b in zip(channels(one.transport.near), channels(other.transport.near), strict=True):
        assert a.data.tobytes() == b.data.tobytes()


def test_bounced_light_has_fringes_too() -> None:
    """Each primary has the room of a projector whose whole picture is shifted and scaled like that primary's."""
    scene = replace(small("corner"), cells=100)
    lateral = (0.03, 0.01, 1.02), (0.0, 0.0, 1.0), (-0.02, 0.02, 0.98)
    drive = np.random.default_rng(5).random((scene.projector.pixels, 3))

    def seen(places: tuple[tuple[float, float, float], ...]) -> FloatArray:
        return simulate(replace(scene, projector=replace(scene.projector, lateral=places))).transport.apply(drive)

    together = seen(lateral)
    for channel, place in enumerate(lateral):
        np.testing.assert_allclose(together[:, channel], seen((place,) * 3)[:, channel], rtol=1e-6)


def convolved(drive: FloatArray, radius: float) -> FloatArray:
    far = np.arange(-60, 61)
    kernel = np.exp(-np.hypot(far[:, None], far) / radius)
    return np.asarray(fftconvolve(drive, kernel / kernel.sum(), mode="same"))


def pixels_of(angle: float, scene: Scene) -> float:
    return float(np.tan(np.radians(angle)) * scene.projector.width / 2 / scene.projector.tan_half[0])


def test_the_halo_is_a_convolution_that_reaches_beyond_the_raster(tmp_path: Path) -> None:
    scene = load_scene(scene_file(tmp_path, plane(extra=WHITE), projector=HALO)).resized(projector=(40, 64))
    drive = np.zeros((40, 64))
    drive[:, 32:] = 1
    drive[10:14, 5:9] = 0.8
    result = simulate(matching(scene, 20, samples=2))
    seen = result.transport.apply(np.repeat(drive.reshape(-1, 1), 3, axis=1)).reshape(80, 104, 3)
    sharp = np.pad(drive, 20)
    expected = 0.93 * sharp + 0.07 * convolved(sharp, pixels_of(1.5, scene))
    np.testing.assert_allclose(seen, np.repeat(expected[..., None], 3, axis=2), atol=0.002)  # for cells of two pixels
    assert seen[..., 1].sum() == pytest.approx(drive.sum(), rel=0.002)
    assert seen[40, 86, 1] > 0.01  # beyond the raster
    assert {each.need.effect: each.energy_share for each in result.reports}["halo"] == pytest.approx(0.07, rel=0.001)
    alike = Emission(Lens(halo=0.07), (40, 64))(np.repeat(drive.reshape(-1, 1), 3, axis=1)).reshape(52, 76, 3)
    outside = [seen[40, 51, 1], alike[26, 37, 1]]  # next to white: half of the halo, half a pixel from the edge
    np.testing.assert_allclose(outside, 0.031, atol=0.003)


def test_a_halo_is_reflected_like_the_light_that_it_is_made_of() -> None:
    """Inside the raster, a picture in the room with a halo equals a convolved picture in the room without a halo."""
    scene = replace(small("corner"), cells=100)
    drive = np.zeros((24, 40))
    drive[9:15, 16:24] = 1
    halo = replace(scene.projector, halo_share=0.2, halo_radius=np.radians(3.0), vignetting=0.2)
    plain = simulate(replace(scene, projector=replace(halo, halo_share=0.0, halo_radius=0.0))).transport
    found = simulate(replace(scene, projector=halo)).transport.apply(np.repeat(drive.reshape(-1, 1), 3, axis=1))
    emitted = 0.8 * drive + 0.2 * convolved(drive, pixels_of(3.0, scene))
    expected = plain.apply(np.repeat(emitted.reshape(-1, 1), 3, axis=1))
    np.testing.assert_allclose(found, expected, atol=0.004 * expected.max())


def codes_like(rng: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Return colours whose second and third primary are alike, so that the rig's unequal weights do not matter."""
    first, others = rng.integers(0, 256, (2, *shape))
    return np.stack([first, others, others], axis=-1).astype(np.uint8)


def test_colour_processing_is_the_rigs(tmp_path: Path, rng: np.random.Generator) -> None:
    room = simulated_rooms(scene_file(tmp_path, plane(), projector=VIVID))[0]
    rig = rig_projector.Projector((2.2, 2.2, 2.2), black=0, vividness=(0.25, 0.2, 0.15))
    for turn in range(3):
        codes = np.roll(codes_like(rng, (12, 16)), turn, axis=2)
        light = rig.light(codes).reshape(12, 16, 3)[..., turn]
        np.testing.assert_allclose(room.response.to_linear(codes)[..., turn], light, rtol=1e-9, atol=1e-12)


def test_gains_wander_like_the_rigs(tmp_path: Path, rng: np.random.Generator) -> None:
    path = scene_file(tmp_path, plane(extra=WHITE), camera="wander = 0.025")
    camera = SimulatedCamera(simulated_rooms(path)[0], CameraSettings(Sensor(0, 0, 16)))
    white = np.full((12, 16, 3), 255, np.uint8)
    seen = np.array([camera.exposures.radiance(camera.capture(i, white)).mean(axis=(0, 1)) for i in range(400)])
    rig = rig_sensor.Sensor(16, 0, 0, wander=0.025)
    judged = np.array([rig.codes(np.full((1, 1, 3), 0.7), np.ones(3), rng)[0, 0] for _ in range(4000)]).astype(float)
    spreads = [each.std(axis=0) / each.mean(axis=0) for each in (seen, judged)]
    np.testing.assert_allclose(*spreads, rtol=0.12)  # error of a deviation over 400 gains: 3.5 %
    assert np.abs(np.corrcoef(seen.T)[np.triu_indices(3, 1)]).max() < 0.2  # each channel has its own gain
    np.testing.assert_array_equal(camera.exposures.radiance(camera.capture(7, white)).mean(axis=(0, 1)), seen[7])


@pytest.mark.parametrize("curve", ['"srgb"', str(S_CURVE)])
def test_captures_have_the_cameras_curve(tmp_path: Path, curve: str) -> None:
    path = scene_file(tmp_path, plane(extra="albedo = [1, 0.5, 0.1]"), camera=f"response = {curve}")
    room = simulated_rooms(path)[0]
    (codes,) = SimulatedCamera(room, CameraSettings(Sensor(0, 0, 8))).capture(0, np.full((12, 16, 3), 255, np.uint8))
    light = room.transport.composition().reshape(14, 20, 3)
    light = light * 0.8 / light.max()
    encoded = 1.055 * light ** (1 / 2.4) - 0.055 if "srgb" in curve else light * (0.5 + 1.5 * light - light**2)
    assert codes.dtype == np.uint8
    np.testing.assert_allclose(codes, 255 * encoded, atol=0.51)


@pytest.mark.parametrize(
    ("curve", "given", "known", "believed"),
    [
        ("", [], True, "linear"),
        ('response = "srgb"', [], False, "linear"),
        ('response = "srgb"', ["--camera-response", "2.2"], True, "gamma"),
    ],
)
def test_the_curve_of_a_scene_is_unknown_unless_it_is_given(
    tmp_path: Path, curve: str, given: list[str], known: bool, believed: str
) -> None:
    parser = Parser("acquire")
    add_rig_options(parser)
    source = f"simulated:{scene_file(tmp_path, plane(), camera=curve)}"
    with open_rig(parser.parse_args(["--camera", source, *given])) as (camera, _):
        assert (camera.exposures.known, camera.exposures.response.kind) == (known, believed)
        (codes,) = camera.capture(0, np.full((12, 16, 3), 255, np.uint8))
    # white fills four fifths of the range; sRGB has 90.6 % of the codes there
    assert codes.max() / 65535 == pytest.approx(0.906 if curve else 0.8, abs=0.02)


def test_the_report_has_the_devices_effects_of_which_t_has_none(tmp_path: Path) -> None:
    devices = {"projector": VIVID, "camera": 'wander = 0.025\nresponse = "srgb"'}
    plain, result = (simulate(load_scene(scene_file(tmp_path, plane(), **each))) for each in ({}, devices))
    found = {each.need.effect: each for each in result.reports if each.need.on}
    assert list(found) == ["direct", "colour_processing", "wander", "camera_curve"]
    assert f"{found['wander']}".split()[:5] == ["wander", "on", "0.00", "0", "~2.50"]
    light = np.linspace(0, 1, 10001)
    off = np.sqrt(
        np.mean((np.where(light < 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055) - light) ** 2)
    )
    assert found["camera_curve"].energy_share == pytest.approx(off, rel=0.01)
    assert 0.05 < found["colour_processing"].energy_share < 0.25
    for a, b in zip(channels(plain.transport.near), channels(result.transport.near), strict=True):
        assert a.data.tobytes() == b.data.tobytes()


def test_fringes_and_halos_are_judged_at_the_width_that_they_have(tmp_path: Path) -> None:
    """The small room of `--explain` moves and scatters light by as many pixels as the scene."""
    scene = load_scene(scene_file(tmp_path, plane(), projector=f"{FRINGES}\n{HALO}")).resized((280, 400), (240, 320))
    tiny = small_room(scene)
    assert tiny.projector.width < 100
    moved = [each.projector.width * (np.array(each.projector.lateral) - (0, 0, 1)) for each in (scene, tiny)]
    np.testing.assert_allclose(moved[1], moved[0], rtol=0.01, atol=1e-9)  # pixel sizes are rounded to whole pixels
    radii = [pixels_of(np.degrees(each.projector.halo_radius), each) for each in (scene, tiny)]
    assert radii[1] == pytest.approx(radii[0], rel=0.01)


CHECKER = """pattern = { kind = "checker", colours = [[0.9, 0.8, 0.7], [0.4, 0.3, 0.5]], repeat = [21, 23] }
[ambient]
irradiance = [0.02, 0.02, 0.02]"""
BLUR = "aperture = 0.06\nfocus_distance = 1.6\n"  # the measurement of a curve needs light of several parts of a picture


def acquired(tmp_path: Path, **devices: str) -> tuple[SimulatedRoom, Acquisition]:
    path = scene_file(tmp_path, plane(extra=CHECKER), fov="17", **devices)
    path.write_text(path.read_text().replace("width = 20", "width = 40").replace("height = 14", "height = 28"))
    room = simulated_rooms(path)[0]
    camera = SimulatedCamera(room, CameraSettings(room.sensor or Sensor(), known=False))
    store = MemoryStore(camera.exposures, averaged=False)
    return room, acquire(camera, store, HierarchicalScheme(), room.projectors)[0]


@pytest.mark.parametrize(
    ("devices", "curved", "wanders", "processed"),
    [
        ({"projector": FRINGES}, False, False, False),
        ({"projector": HALO}, False, False, False),
        ({"projector": VIVID}, False, False, True),
        ({"camera": "wander = 0.025"}, False, True, False),
        ({"projector": BLUR, "camera": 'response = "srgb"\nsensor = { bits = 8 }'}, True, False, False),
        ({"projector": BLUR, "camera": f"response = {S_CURVE}\nsensor = {{ bits = 12 }}"}, True, False, False),
    ],
    ids=["lateral_colour", "halo", "colour_processing", "wander", "sRGB", "S-curve"],
)
def test_acquire_measures_the_room(
    tmp_path: Path, devices: dict[str, str], curved: bool, wanders: bool, processed: bool
) -> None:
    """T agrees, up to the exposure that a curve leaves unknown, and no effect is found that the scene does not have."""
    room, done = acquired(tmp_path, **devices)
    found, truth = dense(done.measured.transport), dense(room.transport)
    exposure = np.vdot(found, truth) / np.vdot(found, found)
    assert np.linalg.norm(exposure * found - truth) < 0.02 * np.linalg.norm(truth)
    assert exposure == pytest.approx(1, abs=0.1 if curved else 0.015)  # the mean of 16 gains
    assert (done.curve is not None and not done.curve.is_straight) == curved
    assert done.wander is not None
    assert done.wander.is_active == wanders
    assert done.light is not None
    measured, described = done.light.response.processing, room.response.responses[0].processing
    assert (measured is not None) == processed
    if measured is not None and described is not None:
        assert np.median(np.abs(np.array(measured.samples) - described.samples)) < 0.01
