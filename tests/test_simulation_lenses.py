"""Lenses and the sensor: thin-lens blur, vignetting, halos, noise, against closed forms and brute force."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from counterlight.response import Response
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.simulation.effects import capture_noise
from counterlight.tools.simulation.effects.capture_noise import capture, deviation
from counterlight.tools.simulation.effects.glare import halo_of
from counterlight.tools.simulation.effects.vignetting import transmission
from counterlight.tools.simulation.lens import LensPoints
from counterlight.tools.simulation.needs import needs_of
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import Simulated, simulate
from counterlight.tools.transport.transport import Csr, channel, channels
from tests.scenes import plane, rectangle, scene_file, small

FloatArray = NDArray[np.float64]
WHITE = "albedo = [1, 1, 1]"


def fronto_parallel(tmp_path: Path, samples: int = 8) -> Scene:
    """Return a white plane 2 m before projector and camera, with 41 x 41 pixels that coincide."""
    scene = load_scene(scene_file(tmp_path, plane(extra=WHITE)))
    projector, camera = scene.projector.resized(41, 41), scene.camera.resized(41, 41)
    return replace(scene, projector=projector, camera=replace(camera, tan_half=projector.tan_half), samples=samples)


def blurred(scene: Scene, device: str, diameter_pixels: float) -> Scene:
    """Open one device's lens until points of the plane have circles of confusion of that diameter."""
    opened = replace(getattr(scene, device), aperture=0.1, focus_distance=1.0)
    factor = diameter_pixels / float(opened.blur_pixels(np.array([2.0]))[0])
    return replace(scene, **{device: replace(opened, aperture=0.1 * factor)})


def variance(weights: FloatArray) -> tuple[float, float]:
    """Return the variance of a picture along x and y, in pixels²."""
    y, x = np.mgrid[: weights.shape[0], : weights.shape[1]]
    share = weights / weights.sum()
    return tuple(float((share * (c - (share * c).sum()) ** 2).sum()) for c in (x, y))  # type: ignore[return-value]


def test_the_circle_of_confusion_is_the_thin_lens(tmp_path: Path) -> None:
    """A disc of diameter a |1 − z/f| on the plane, z = 2 and f = 1, is as large as the aperture."""
    scene = fronto_parallel(tmp_path)
    opened = replace(scene.projector, aperture=0.05, focus_distance=1.0)
    pixel = 2 * 2 * opened.tan_half[0] / 41  # width of a pixel on the plane
    assert float(opened.blur_pixels(np.array([2.0]))[0]) == pytest.approx(0.05 / pixel)


def cut_out(T: Csr, cut: Any) -> FloatArray:
    """Return rows or columns of T as pictures of 41 x 41 pixels."""
    part = T[cut].toarray()
    return np.asarray(part if part.shape[1] == 41 * 41 else part.T).reshape(-1, 41, 41)


@pytest.mark.parametrize("device", ["projector", "camera"])
def test_a_blurred_pixel_is_a_disc(tmp_path: Path, device: str) -> None:
    """A uniform disc of diameter d adds a variance of d²/16 per axis to the sharp pixel's variance."""
    scene = fronto_parallel(tmp_path)
    sharp = channel(simulate(scene).transport.near, 1)
    soft = channel(simulate(blurred(scene, device, 9.0)).transport.near, 1)
    middle = 20 * 41 + 20
    around = middle + np.add.outer(41 * np.arange(-4, 5), np.arange(-4, 5)).ravel()
    for cut in (np.s_[around], np.s_[:, around]):  # camera pixels' footprints, and projector pixels' images
        after, before = (np.mean([variance(p) for p in cut_out(T, cut)], axis=0) for T in (soft, sharp))
        # Whole pixels instead of exact places add 1/6. 64 rays hit about as many pixels: 2 %.
        np.testing.assert_allclose(after - before, 9.0**2 / 16 + 1 / 6, rtol=0.02)
    y, x = np.mgrid[:41, :41]
    assert soft[[middle]].toarray().reshape(41, 41)[np.hypot(x - 20, y - 20) > 4.5 + 1.5].max() == 0


@pytest.mark.parametrize("device", ["projector", "camera"])
def test_blur_keeps_the_light(tmp_path: Path, device: str) -> None:
    """Away from the edge, an even picture stays even: T·1 equals the pinhole's T·1."""
    scene = fronto_parallel(tmp_path)
    sharp, soft = (simulate(s).transport.composition().reshape(41, 41, 3) for s in (scene, blurred(scene, device, 6.0)))
    inner = slice(5, -5), slice(5, -5)
    np.testing.assert_allclose(soft[inner], sharp[inner], rtol=5e-3)  # the plane is slightly darker off the axis
    assert soft[0, 20, 0] < 0.8 * sharp[0, 20, 0] or device == "camera"


@pytest.mark.parametrize("device", ["projector", "camera"])
def test_in_focus_a_lens_is_a_pinhole_to_the_bit(tmp_path: Path, device: str) -> None:
    scene = fronto_parallel(tmp_path, samples=2)
    focused = replace(scene, **{device: replace(getattr(scene, device), aperture=0.05)})
    need = needs_of(focused)[f"{device}_defocus"]
    assert not need.on
    assert "everything is sharp" in need.reason
    assert_same_bits(simulate(scene), simulate(focused))


def assert_same_bits(a: Simulated, b: Simulated) -> None:
    for one, other in zip(channels(a.transport.near), channels(b.transport.near), strict=True):
        assert one.data.tobytes() == other.data.tobytes()
        assert one.indices.tobytes() == other.indices.tobytes()
        assert one.indptr.tobytes() == other.indptr.tobytes()
    assert a.ambient.tobytes() == b.ambient.tobytes()


def test_a_lens_sees_around_an_edge(tmp_path: Path) -> None:
    """Half way to the lens, a card casts a half shadow as wide as the lens. A pinhole's shadow is sharp."""
    card = rectangle([-1.0, -1.0, 1.0], [1.0, 0, 0], [0, 2.0, 0], 0.0)
    scene = load_scene(scene_file(tmp_path, plane(extra=WHITE) + card))
    aside = replace(scene.camera, position=np.array([0.2, 0.0, 2.0])).resized(9, 240)
    scene = replace(scene, camera=aside, samples=4)
    soft = replace(scene, projector=replace(scene.projector, aperture=0.1, focus_distance=2.05))
    for room, width in ((scene, 0.0), (soft, 0.1)):
        row = simulate(room).transport.composition().reshape(9, 240, 3)[4, :, 0]
        x = 0.2 + (2 * (np.arange(240) + 0.5) / 240 - 1) * 2 * aside.tan_half[0]
        level = row[np.abs(x - 0.2).argmin()]
        rising = x[(row > 0.02 * level) & (row < 0.98 * level) & (x < 0.4)]
        assert (np.ptp(rising) if rising.size else 0.0) == pytest.approx(width, abs=0.02)  # one pixel is 6 mm wide


def test_lens_points_fill_the_disc_evenly() -> None:
    pixels = np.repeat(np.arange(4), 16)
    across, up = LensPoints(2.0).of(pixels, 16)
    assert across.shape == (64, 16)
    radius = np.hypot(across, up)
    assert radius.max() <= 1
    for pixel in range(4):
        own = radius[pixels == pixel].ravel()
        assert np.mean(own < np.sqrt(0.5)) == pytest.approx(0.5, abs=0.02)  # half the area, 256 points
        assert len(np.unique(own.round(9))) == 256  # all different


# Vignetting


def test_vignetting_dims_columns_and_rows(tmp_path: Path) -> None:
    scene = fronto_parallel(tmp_path, samples=1)  # pixels coincide, so T is diagonal
    even = channel(simulate(scene).transport.near, 0).diagonal()
    projector, camera = (replace(device, vignetting="cos4") for device in (scene.projector, scene.camera))
    y, x = np.mgrid[:41, :41]
    tan = np.hypot(2 * (x + 0.5) / 41 - 1, 2 * (y + 0.5) / 41 - 1).ravel() * scene.projector.tan_half[0]
    expected = np.cos(np.arctan(tan)) ** 4
    one, two = replace(scene, projector=projector), replace(scene, projector=projector, camera=camera)
    for room, power in ((one, 1), (two, 2)):
        assert needs_of(room)["vignetting"].on
        np.testing.assert_allclose(
            channel(simulate(room).transport.near, 0).diagonal() / even, expected**power, rtol=1e-5
        )
    share = transmission(replace(scene.projector, vignetting=0.3).resized(400, 400))
    assert share[0] == pytest.approx(0.7, abs=2e-3)  # half a pixel inside the corner
    assert share.max() == pytest.approx(1, abs=1e-4)


# Blooming


def test_halos_are_the_convolution(tmp_path: Path) -> None:
    """A lit pixel becomes (1 − s) δ + s h, recomputed pixel by pixel. Here a cell is a pixel."""
    scene = fronto_parallel(tmp_path, samples=2)
    camera = scene.camera.resized(30, 40)
    radius = 3.0
    angle = np.arctan(radius * 2 * camera.tan_half[0] / 40)
    scene = replace(scene, camera=replace(camera, bloom_share=0.1, bloom_radius=angle))
    sharp = simulate(scene, without=["blooming"])
    soft = simulate(scene)
    lit = np.zeros((41 * 41, 3))
    lit[20 * 41 + 20] = 1
    before, after = (room.transport.apply(lit)[:, 1].reshape(30, 40) for room in (sharp, soft))
    far = np.arange(-40, 41)
    kernel = np.exp(-np.hypot(far[:, None], far) / radius)
    kernel /= kernel.sum()
    expected = 0.9 * before
    for y, x in np.argwhere(before > 0):
        expected += 0.1 * before[y, x] * kernel[40 - y : 70 - y, 40 - x : 80 - x]
    np.testing.assert_allclose(after, expected, rtol=1e-3, atol=1e-6 * before.max())  # kernels cut at 24 and 40 pixels
    assert after.sum() == pytest.approx(before.sum(), rel=0.01)  # the halo stays inside the picture


def test_halos_of_far_light_and_ambient_light() -> None:
    """T' 1 + e' is the halo of T 1 + e, far light included: blooming is one linear map of camera pictures."""
    scene = small("corner")
    scene = replace(scene, cells=60, camera=replace(scene.camera, bloom_share=0.2, bloom_radius=0.02))
    sharp, soft = simulate(scene, without=["blooming"]), simulate(scene)

    glare = halo_of(scene.camera, scene.camera.bloom_radius)
    average, halo, interpolate = glare.average, glare.kernel, glare.interpolate
    before = sharp.transport.composition() + sharp.ambient.reshape(-1, 3)
    expected = 0.8 * before + 0.2 * (interpolate @ (halo @ (average @ before)))
    after = soft.transport.composition() + soft.ambient.reshape(-1, 3)
    np.testing.assert_allclose(after, expected, rtol=1e-5)  # rounding to float32
    assert soft.transport.far is not None
    dark = simulate(scene).transport.apply(np.zeros((soft.transport.shape[1], 3)))
    assert not dark.any()


# The sensor


def test_noise_has_the_variance_of_its_electrons(tmp_path: Path, rng: np.random.Generator) -> None:
    sensor = "sensor = { full_well_electrons = 5000, read_noise_electrons = 12, bits = 12 }"
    camera = load_scene(scene_file(tmp_path, plane(), camera=sensor)).camera
    radiance = np.full((300, 300, 3), 0.4)
    assert camera.sensor
    codes = capture(0.5 * radiance, camera.sensor, camera.response, rng) / 4095  # the mean is 1000 electrons
    assert codes.mean() == pytest.approx(0.2, rel=1e-3)
    electrons = codes.std() * 5000
    rounding = 5000 / 4095 / np.sqrt(12)
    assert electrons == pytest.approx(np.sqrt(1000 + 12**2 + rounding**2), rel=0.01)  # error of 270 000 samples
    assert capture(50 * radiance, camera.sensor, camera.response, rng).min() == 4095  # saturated
    expected = deviation(camera, np.array([0.4, 2.0]))  # the brightest value, 2, is close enough to the percentile
    assert expected[0] / 2 == pytest.approx(codes.std(), rel=0.02)


@pytest.mark.parametrize("mean", [16, 17.3, 40, 1000, 19999])
@pytest.mark.parametrize("cores", [0, 1])
def test_photons_of_normal_numbers_are_poissons(mean: float, cores: int) -> None:
    """A million normal numbers at equal steps of probability replace random draws."""
    steps = 1_000_000
    normal = stats.norm.ppf((np.arange(steps) + 0.5) / steps).astype(np.float32)
    electrons = np.full(steps, float(mean))
    capture_noise._MANY_ELECTRONS[cores](electrons, normal)
    found = np.bincount(electrons.astype(int)) / steps
    expected = stats.poisson.pmf(np.arange(found.size), mean)
    # 5e-4 at a mean of 16, where the method changes
    np.testing.assert_allclose(found, expected, atol=6e-4 * expected.max() + 3 / steps)
    assert electrons.var() == pytest.approx(mean, rel=1e-3)


def test_few_photons_are_counted_and_many_are_not_moved(rng: np.random.Generator) -> None:
    """In partly dark pictures, each value has its own mean and variance."""
    light = np.repeat([0, 3, 15.9, 16, 400], 60_000).reshape(5, -1, 3) / 1e4
    noisy = 1e4 * capture_noise._noisy(light, Sensor(1e4, 0, 16), rng).reshape(5, -1)
    np.testing.assert_allclose(noisy, np.rint(noisy), atol=1e-9)  # whole electrons, up to the division
    for drawn, mean in zip(noisy, (0, 3, 15.9, 16, 400), strict=True):
        assert drawn.mean() == pytest.approx(mean, abs=5 * np.sqrt(mean / drawn.size))
        assert drawn.var() == pytest.approx(mean, rel=0.03)  # five standard deviations of 60 000 draws


def test_a_capture_goes_through_the_response(tmp_path: Path, rng: np.random.Generator) -> None:
    sensor = "sensor = { full_well_electrons = 1e9, read_noise_electrons = 0, bits = 8 }\nresponse = 'srgb'"
    camera = load_scene(scene_file(tmp_path, plane(), camera=sensor)).camera
    codes = np.arange(256)
    light = Response("srgb").to_linear(np.repeat(codes[:, None], 3, axis=1) / 255)[None]
    assert camera.sensor
    np.testing.assert_array_equal(capture(light, camera.sensor, camera.response, rng)[0, :, 0], codes)
