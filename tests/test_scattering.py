"""Gloss and subsurface scattering: lobes return at most the light they receive, and profiles keep the albedo."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate, special

from counterlight.errors import InputError
from counterlight.tools.simulation.bands import camera_samples
from counterlight.tools.simulation.effects import gloss, subsurface
from counterlight.tools.simulation.effects_on import EffectsOn
from counterlight.tools.simulation.geometry import trace
from counterlight.tools.simulation.needs import chosen, needs_of
from counterlight.tools.simulation.projector_side import irradiance
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.transport.transport import channel, channels

FloatArray = NDArray[np.float64]


# Gloss


@pytest.mark.parametrize("roughness", [0.1, 0.4, 1.0])
@pytest.mark.parametrize("degrees", [0.0, 40.0, 75.0])
def test_in_a_white_furnace_the_lobe_returns_at_most_what_it_gets(roughness: float, degrees: float) -> None:
    """Quadrature gives ∫ f cos i over the hemisphere. The mean weight of the sampler is the same integral."""
    for head_on in (0.04, 1.0):
        albedo = directional_albedo(roughness, degrees, head_on)
        assert 0.5 * head_on * (1 - np.log(2)) < albedo <= 1
        side = 256
        grid = (np.indices((side, side)).reshape(2, -1).T + 0.5) / side
        leaving = np.tile(direction(degrees), (side**2, 1))
        towards, weight = gloss.sampled(leaving, up(side**2), roughness, head_on, grid)
        np.testing.assert_allclose(np.linalg.norm(towards, axis=1), 1, rtol=1e-12)
        assert weight.max() <= 1
        assert weight.mean() == pytest.approx(albedo, abs=2e-3)  # each stratum is 1/256 of the tail


def test_the_roughest_lobe_at_normal_incidence_has_a_closed_form() -> None:
    """With α = 1, D = 1/π and G = cos 2h / cos² h: the integral of 2 tan h cos 2h from 0 to π/4 is 1 − ln 2."""
    # error at the horizon, where the lobe is cut
    assert directional_albedo(1.0, 0.0, 1.0) == pytest.approx(1 - np.log(2), rel=1e-3)


@pytest.mark.parametrize("roughness", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("head_on", [0.0, 0.04, 0.5, 1.0])
def test_a_coat_over_white_paint_returns_at_most_what_it_gets(roughness: float, head_on: float) -> None:
    for degrees in (0.0, 30.0, 60.0, 75.0, 85.0):
        paint = (1 - gloss.fresnel(np.cos(np.radians(degrees)), head_on)) * (1 - gloss.mean_fresnel(head_on))
        assert directional_albedo(roughness, degrees, head_on) + paint <= 1 + 1e-6  # error of the quadrature


def test_the_sampler_draws_the_lobe_and_no_other() -> None:
    """Sampling and quadrature agree on the mean of an arbitrary picture of the surroundings."""
    roughness, leaving = 0.3, direction(50)
    side = 128
    grid = (np.indices((side, side)).reshape(2, -1).T + 0.5) / side
    towards, weight = gloss.sampled(np.tile(leaving, (side**2, 1)), up(side**2), roughness, 0.5, grid)
    sampled = np.mean(weight * scenery(towards))
    assert sampled == pytest.approx(directional_albedo(roughness, 50, 0.5, True), abs=2e-3)


def test_the_lobe_is_reciprocal(rng: np.random.Generator) -> None:
    a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 100, 3)))
    a[:, 2], b[:, 2] = np.abs(a[:, 2]), np.abs(b[:, 2])
    there, back = gloss.lobe_between(a, b, up(100), 0.3, 0.04), gloss.lobe_between(b, a, up(100), 0.3, 0.04)
    np.testing.assert_allclose(there, back, rtol=1e-12)
    assert there.min() > 0
    np.testing.assert_array_equal(gloss.lobe_between(a * [1, 1, -1], b, up(100), 0.3, 0.04), 0)


def test_a_glossy_fold_shows_the_other_side_as_many_rays_do(tmp_path: Path) -> None:
    """A camera pixel looks at a black coated card next to a lit white card. An integral over the white card agrees."""
    scene = load_scene(scene_file(tmp_path, FOLD, GLOSSY))
    far = channel(simulate(scene, only=["direct", "shadows", "gloss"]).transport.near, 1).sum()
    hit = trace(scene.camera.position, scene.camera.forward[None], scene.surfaces)
    assert hit.surface[0] == 1
    side = 400
    u, v = (part.ravel() for part in np.meshgrid(*2 * [(np.arange(side) + 0.5) / side]))
    card = scene.surfaces[0].shape
    points, area = card.at(u, v), card.density(u, v) / side**2
    between = points - hit.point[0]
    distance = np.linalg.norm(between, axis=1, keepdims=True)
    towards = between / distance
    cos_in, cos_card = towards @ hit.normal[0], np.abs(np.sum(towards * card.normals(u, v), axis=1))
    leaving = np.tile(-scene.camera.forward, (len(points), 1))
    f = gloss.lobe_between(towards, leaving, np.tile(hit.normal[0], (len(points), 1)), 0.3, 0.8)
    radiance = irradiance(scene, points, card.normals(u, v)) / np.pi
    x, y, _ = scene.projector.project(points)
    radiance *= scene.projector.pixel_at(x, y) >= 0
    expected = np.sum(f * cos_in * cos_card * radiance * area / distance[:, 0] ** 2)
    assert expected > 0.01
    assert far == pytest.approx(expected, rel=0.05)  # error of 256 rays in the pixel


FOLD = """
[[surfaces]]
corner = [0, -0.5, 0]
edge_u = [0.7, 0, 0.7]
edge_v = [0, 1, 0]
albedo = [1, 1, 1]
"""
GLOSSY = """
[[surfaces]]
corner = [0, -0.5, 0]
edge_u = [-0.7, 0, 0.7]
edge_v = [0, 1, 0]
albedo = [0, 0, 0]
gloss = { reflectance = 0.8, roughness = 0.3 }
"""


def scene_file(tmp_path: Path, *surfaces: str) -> Path:
    """Write a projector that looks from the left onto the right card, and a one-pixel camera on the left card."""
    path = tmp_path / "scene.toml"
    projector = "[projector]\nwidth = 40\nheight = 40\nposition = [-1.5, 0, 2]\nlook_at = [0.4, 0, 0.4]"
    camera = "[camera]\nwidth = 1\nheight = 1\nposition = [0.6, 0, 2]\nlook_at = [-0.35, 0, 0.35]"
    fields = "\nhorizontal_field_of_view_deg = "
    path.write_text(f"samples = 16\n{projector}{fields}14\n{camera}{fields}0.2\n{''.join(surfaces)}")
    return path


def directional_albedo(roughness: float, degrees: float, head_on: float, with_scenery: bool = False) -> float:
    """Return ∫ f cos i (times the scenery) dω over the hemisphere, from half vectors: dω = 4 (o · h) dω_h."""
    theta, weights = gauss(0, np.pi / 2, 200)
    phi = (np.arange(100) + 0.5) / 100 * 2 * np.pi
    # Steps are fine near the normal, where the facets of a smooth surface lie.
    theta, weights = np.pi / 2 * (theta / (np.pi / 2)) ** 3, weights * 3 * (theta / (np.pi / 2)) ** 2
    t, p = (x.ravel() for x in np.meshgrid(theta, phi, indexing="ij"))
    half = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=1)
    leaving = np.tile(direction(degrees), (len(half), 1))
    along = np.sum(half * leaving, axis=1)
    towards = 2 * along[:, None] * half - leaving
    value = gloss.lobe_between(towards, leaving, up(len(half)), roughness, head_on)
    value = value * towards[:, 2] * 4 * along * np.sin(t) * (along > 0)
    if with_scenery:
        value = value * scenery(towards)
    return float(np.sum(value.reshape(200, 100) * weights[:, None]) * 2 * np.pi / 100)


def scenery(towards: FloatArray) -> FloatArray:
    return np.asarray(1 + towards[:, 0] + 0.5 * towards[:, 1] ** 2 + towards[:, 2] * towards[:, 0])


def gauss(low: float, high: float, count: int) -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return (nodes + 1) / 2 * (high - low) + low, weights * (high - low) / 2


def direction(degrees: float) -> FloatArray:
    return np.array([np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))])


def up(count: int) -> FloatArray:
    return np.tile([0, 0, 1.0], (count, 1))


# Subsurface scattering


def test_the_profile_holds_all_the_light() -> None:
    for width in (0.3, 2.0):
        whole, _ = integrate.quad(lambda r, w=width: 2 * np.pi * r * subsurface.profile(r, w), 0, 60 * width)
        assert whole == pytest.approx(1, rel=1e-8)  # the remaining light, e⁻²⁰, is omitted


def test_radii_are_drawn_as_the_profile_says() -> None:
    for share in (0.0, 0.2, 0.5, 0.9, 0.999):
        radius = float(subsurface.radius_within(np.array(share)))
        within, _ = integrate.quad(lambda r: 2 * np.pi * r * subsurface.profile(r, 1.0), 0, radius)
        assert within == pytest.approx(share, abs=1e-9)


WAX = """
[[surfaces]]
corner = [-1, -1, 0]
edge_u = [2, 0, 0]
edge_v = [0, 2, 0]
albedo = [0.8, 0.8, 0.6]
translucency = { mean_free_path = [0.08, 0.02, 0.02] }
"""


def wax(tmp_path: Path) -> Scene:
    """Return a translucent plane. The projector looks straight down onto it, the camera from the side."""
    path = tmp_path / "scene.toml"
    projector = "[projector]\nwidth = 60\nheight = 40\nposition = [0, 0, 3]\nlook_at = [0, 0, 0]"
    camera = "[camera]\nwidth = 30\nheight = 20\nposition = [0, 0.5, 3]\nlook_at = [0, 0, 0]"
    fields = "\nhorizontal_field_of_view_deg = "
    path.write_text(f"samples = 8\nthreshold = 0\n{projector}{fields}36\n{camera}{fields}10\n{WAX}")
    return load_scene(path)


def test_a_line_of_light_spreads_as_the_profiles_line_integral(tmp_path: Path) -> None:
    """∫ R dy = (K₀(|x| / d) + K₀(|x| / 3d)) / 4 π d, averaged over a projector column, with each channel's own d."""
    scene = wax(tmp_path)
    T = channels(simulate(scene).transport.near)
    side = 4  # places per axis of a camera pixel
    points = trace(scene.camera.position, scene.camera.pixel_rays(range(10, 11), side)[0], scene.surfaces).point
    x = points[:, 0].reshape(30, side**2)
    column, half = 30, 3 * np.tan(np.radians(18)) / 60
    middle = (column + 0.5) * 2 * half - 60 * half
    light = np.pi  # brightness 1 at the distance of look_at
    for colour, (albedo, path) in enumerate(((0.8, 0.08), (0.8, 0.02), (0.6, 0.02))):
        d = path / float(subsurface.scale(np.array(albedo)))
        drive = np.zeros((40, 60))
        drive[:, column] = 1
        seen = (T[colour] @ drive.ravel()).reshape(20, 30)[4:16].mean(axis=0)
        steps = (np.arange(200) + 0.5) / 200 * 2 * half - half
        far = np.abs(x[..., None] - middle - steps)
        line = (special.k0(far / d) + special.k0(far / 3 / d)) / (4 * np.pi * d)
        expected = albedo / np.pi * light * line.mean(axis=(1, 2)) * 2 * half
        # 12 × 256 points for each of 30 places. The camera sees the rows in perspective.
        np.testing.assert_allclose(seen, expected, atol=0.05 * expected.max())
        assert seen.sum() == pytest.approx(expected.sum(), rel=0.02)


def test_even_light_gives_the_albedo(tmp_path: Path) -> None:
    """Many free paths from its edges, a translucent plane under white light is as bright as a matt plane."""
    scene = wax(tmp_path)
    pictures = [simulate(scene, without=names).transport.composition() for names in ([], ["subsurface"])]
    np.testing.assert_allclose(pictures[0][:, 1:], pictures[1][:, 1:], rtol=1e-6)  # rounding to float32
    assert (pictures[0][:, 0] < pictures[1][:, 0]).any()  # red light travels far enough to leave the plane


def test_on_a_ball_no_sample_gathers_more_than_the_whole_profile(tmp_path: Path) -> None:
    """At a radius of many free paths, a sample gathers nearly the whole profile."""
    for radius, least in ((0.5, 0.97), (0.05, 0.5)):
        ball = (
            f'[[surfaces]]\nshape = "sphere"\ncentre = [0, 0, 0]\nradius = {radius}\nalbedo = [0.8, 0.8, 0.8]\n'
            "translucency = { mean_free_path = [0.02, 0.02, 0.02] }\n"
        )
        path = tmp_path / "scene.toml"
        scene = wax(tmp_path)
        path.write_text(path.read_text().replace(WAX, ball))
        scene = load_scene(path)
        effects = EffectsOn(needs_of(scene))
        (straight,) = camera_samples(scene, range(20), EffectsOn(chosen(needs_of(scene), ["subsurface"])))
        gathered = np.zeros(600)
        for batch in camera_samples(scene, range(20), effects):
            gathered += np.bincount(batch.pixel, batch.throughput[:, 0], 600)
        sent = np.bincount(straight.pixel, straight.throughput[:, 0], 600)
        assert (gathered <= sent * (1 + 1e-9)).all()
        assert gathered.sum() > least * sent.sum()


def test_a_surface_is_coated_or_translucent(tmp_path: Path) -> None:
    wax(tmp_path)
    path = tmp_path / "scene.toml"
    path.write_text(path.read_text() + "gloss = { reflectance = 0.04, roughness = 0.2 }\n")
    with pytest.raises(InputError, match=r"scene.toml: surfaces 1: takes gloss or translucency, not both"):
        load_scene(path)
