"""The rig's light: spectra, bounces, footprints and glass against closed forms."""

import numpy as np
import pytest

from tests.rig import light
from tests.rig.faults import FAULTS
from tests.rig.footprints import Aperture, Hits, direct_hits, footprints
from tests.rig.lens import Emission, Lens
from tests.rig.pane import Pane, fresnel, light_behind, refracted
from tests.rig.radiosity import Patches, bounced, form_factors, point_factors
from tests.rig.rays import Rectangle, looking
from tests.rig.rig import Rig
from tests.rig.rooms import ROOMS
from tests.rig.view import Truth, View
from tests.small_rigs import small_rig, small_room

NO_WAVES = np.zeros((1, 4))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(14)


def square(corner: list[float], across: list[float], down: list[float]) -> Rectangle:
    return Rectangle(*(np.array(each, np.float64) for each in (corner, across, down)))


def cube() -> list[Rectangle]:
    x, y, z = [1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]
    near = [square([0, 0, 0], *pair) for pair in ((x, y), (y, z), (z, x))]
    return near + [square(start, *pair) for start, pair in ((z, (x, y)), (x, (y, z)), (y, (z, x)))]


def test_crosstalk_is_what_is_asked_for() -> None:
    assert light.mixed(0.12).of_white() == pytest.approx(
        np.array([[0.88, 0.12, 0], [0.06, 0.88, 0.06], [0, 0.12, 0.88]])
    )
    assert light.separate().of_white() == pytest.approx(np.eye(3))


@pytest.mark.parametrize("name", light.LIGHTS)
def test_every_camera_is_balanced_and_its_colours_are_found_again(name: str) -> None:
    found = light.LIGHTS[name]()
    assert found.of_white().sum(axis=1) == pytest.approx(1)
    # A Nikon is no colorimeter: a fit of nine numbers leaves 0.2 % of white's luminance.
    assert found.to_xyz().sum(axis=1)[1] == pytest.approx(1, abs=2e-3)
    assert found.weakness.min() == pytest.approx(1)


def test_real_primaries_mix_by_a_fifth_to_two_fifths() -> None:
    for name in ("led", "wheel"):
        shares = 1 - np.diag(light.LIGHTS[name]().of_white())
        assert np.all((shares > 0.15) & (shares < 0.45)), name  # 20 to 30 % are required; raw values reach 50 %


def test_a_closed_room_is_a_furnace() -> None:
    factors = form_factors([Patches(side, (2, 3)) for side in cube()])
    assert factors.sum(axis=1) == pytest.approx(1, abs=1e-12)  # contour integrals are exact
    for reflectance in (0.5, 0.98):
        light_of_all = bounced(factors, np.full(len(factors), reflectance)).sum(axis=1)
        assert light_of_all == pytest.approx(reflectance / (1 - reflectance), rel=1e-9)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (square([0, 0, 1], [1, 0, 0], [0, 1, 0]), 0.19982),  # parallel unit squares at distance 1
        (square([0, 0, 0], [1, 0, 0], [0, 0, 1]), 0.20004),  # at a right angle, with a common edge
    ],
)
def test_form_factors_of_unit_squares(other: Rectangle, expected: float) -> None:
    floor = Patches(square([0, 0, 0], [1, 0, 0], [0, 1, 0]), (24, 24))
    factors = form_factors([floor, Patches(other, (2, 2))])
    found = factors[: floor.count, floor.count :].sum(axis=1).mean()
    assert found == pytest.approx(expected, rel=2e-3)  # mean over 72 × 72 points; steep near the edge


def test_the_form_factor_of_a_disc_overhead() -> None:
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    disc = np.stack([0.7 * np.cos(angle), 0.7 * np.sin(angle), np.full_like(angle, 1.3)], axis=1)
    found = point_factors(np.zeros((1, 3)), np.array([[0.0, 0, 1]]), disc[None])
    assert found == pytest.approx(0.49 / (0.49 + 1.69), rel=1e-5)  # r² / (r² + h²)


def test_bounced_light_is_the_sum_of_all_bounces(rng: np.random.Generator) -> None:
    factors = form_factors([Patches(side, (2, 2)) for side in cube()[:3]])
    reflectance = rng.uniform(0.1, 0.9, len(factors))
    once = factors * reflectance
    series = sum(np.linalg.matrix_power(once, n) for n in range(1, 80))
    assert bounced(factors, reflectance) == pytest.approx(series, abs=1e-9)


def test_the_corner_lights_itself() -> None:
    view = small_rig("corner").calibrated
    white = np.ones((small_room("corner").raster[0] * small_room("corner").raster[1], 3))
    direct, whole = view.direct_rise().sum(), view.rise(white).sum()
    assert 1.03 < whole / direct < 1.3  # paper and paint face each other at 112°


def test_footprints_sum_to_the_light_of_a_raster_without_borders() -> None:
    for name in ROOMS:
        truth = Truth(small_room(name), light.separate())
        lit = truth.direct[0].sum(axis=1)
        assert np.all(lit <= truth.unbounded * (1 + 1e-5)), name  # float32 sums
        hits = small_room(name).hits
        height, width = small_room(name).raster
        within = np.all((hits.uv > 1.5) & (hits.uv < np.array([width, height]) - 1.5), axis=1)
        outside = np.zeros(len(lit), np.bool_)
        outside[hits.sample[~within]] = True
        whole = (truth.unbounded > 0) & ~outside
        assert whole.any()
        assert lit[whole] == pytest.approx(truth.unbounded[whole], rel=1e-5)


def test_a_pixel_far_from_its_neighbours_lights_its_own_box() -> None:
    at = np.array([[5.5, 3.5], [5.0, 3.5], [6.5 + 0.41, 3.5]])
    W = footprints(Hits(np.arange(3), at, np.ones(3)), 3, (7, 12), sigma=0.01).toarray().reshape(3, 7, 12)
    assert W[0, 3, 5] == pytest.approx(1)
    assert W[1, 3, 4:6] == pytest.approx([0.5, 0.5])
    assert W[2, 3, 6] == pytest.approx(1)


def test_drift_by_a_whole_pixel_is_the_picture_shifted(rng: np.random.Generator) -> None:
    for name in ("wall", "corner", "glass"):
        height, width = small_room(name).raster
        drive = np.zeros((height, width, 3))
        drive[3:-3, 3:-3] = rng.uniform(size=(height - 6, width - 6, 3))
        still, moved = (Truth(small_room(name), light.separate(), shift) for shift in ((0.0, 0.0), (1.0, -2.0)))
        seen = [View(truth, small_room(name).lattice.wide()) for truth in (still, moved)]
        expected = seen[0].rise(np.roll(drive, (-2, 1), axis=(0, 1)).reshape(-1, 3))
        # rounding to float32
        assert seen[1].rise(drive.reshape(-1, 3)) == pytest.approx(expected, abs=1e-4 * expected.max())


def test_the_surroundings_of_white_rise_by_half_the_halo_which_loses_no_light(rng: np.random.Generator) -> None:
    lens, raster = Lens(halo=0.07), (40, 64)
    margin, emit = lens.margin(raster), Emission(lens, raster)
    drive = np.zeros((*raster, 3))
    drive[:, 32:] = 1
    light = emit(drive.reshape(-1, 3)).reshape(40 + 2 * margin, 64 + 2 * margin, 3)
    middle = light[margin + 20, margin:-margin, 0]
    assert margin == 6  # the halo reaches 96 of 1024 pixels
    assert 0.025 < middle[31] < 0.035 < 0.965 < middle[32] < 0.975  # half of 7 %, half a pixel from the edge
    assert middle[: 32 - margin] == pytest.approx(0)
    assert light.sum() == pytest.approx(drive.sum(), rel=1e-5)
    u, v = rng.uniform(size=(40 * 64, 3)), rng.uniform(size=(light.size // 3, 3))
    assert np.sum(emit(u) * v) == pytest.approx(np.sum(u * emit.adjoint(v)), rel=1e-5)  # rounding to float32


def test_lateral_colour_is_the_drift_of_red_and_blue(rng: np.random.Generator) -> None:
    lens = Lens(shifts=((1.0, 0.4), (0.0, 0.0), (-0.9, -0.3)))
    room = small_room("corner")
    view, drive = room.lattice.calibrated(), rng.uniform(size=(room.raster[0] * room.raster[1], 3))
    seen = View(Truth(room, light.separate(), lens=lens), view).rise(drive)
    for channel, shift in enumerate(lens.shifts):
        moved = View(Truth(room, light.separate(), shift), view).rise(drive)
        assert seen[:, channel] == pytest.approx(moved[:, channel], abs=1e-5 * seen.max())


def test_matrices_and_rays_tell_the_same_behind_a_lens_with_all_faults(rng: np.random.Generator) -> None:
    rig = Rig(small_room("corner"), FAULTS["real"].devices)
    u, v = rng.uniform(size=(rig.raster[0] * rig.raster[1], 3)), rng.uniform(size=(rig.camera[0] * rig.camera[1], 3))
    seen = rig.transport.apply(u)
    assert rig.exposure * rig.calibrated.rise(u) == pytest.approx(seen, abs=2e-5 * seen.max())  # float32 sums
    assert np.sum(rig.transport.adjoint(v) * u) == pytest.approx(np.sum(v * seen), rel=1e-5)


@pytest.mark.parametrize("radius", [0.0, 0.15])
def test_a_lens_out_of_focus_spreads_a_pixel_and_loses_no_light(radius: float) -> None:
    projector = looking((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 40.0, (20, 20))
    n, side = 180, 1.2
    grid = (np.arange(n) + 0.5) / n * side - side / 2
    y, x = (each.ravel() for each in np.meshgrid(grid, grid, indexing="ij"))
    points = np.stack([x, y, np.full(n * n, 2.4)], axis=1)
    normals = np.broadcast_to([0.0, 0, 1], points.shape)
    lens = Aperture(radius, 2.0, 19)
    W = footprints(direct_hits(projector, lens, points, normals, np.arange(n * n), []), n * n, (20, 20))
    spot = W[:, [10 * 20 + 10]].toarray().ravel()
    # A pixel next to the axis has flux 1. 180² samples; a pixel is 9 samples wide.
    assert spot.sum() * (side / n) ** 2 == pytest.approx(1, rel=5e-3)
    across = np.sqrt((spot * (x - (spot * x).sum() / spot.sum()) ** 2).sum() / spot.sum())
    pixel = 2.4 / 40
    disc = radius * abs(2.4 / 2.0 - 1)
    expected = np.sqrt(pixel**2 * (1 / 12 + 0.3**2 * 0.973) + (disc / 2) ** 2)  # box, cut Gaussian, disc
    assert across == pytest.approx(expected, rel=0.02)  # 19 points represent the disc


def test_what_stands_between_casts_a_shadow() -> None:
    projector = looking((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 40.0, (20, 20))
    points = np.array([[-0.2, 0, 2.0], [0.2, 0, 2.0]])
    normals = np.broadcast_to([0.0, 0, 1], points.shape)
    screen = square([0.0, -1, 1.0], [1, 0, 0], [0, 2, 0])
    hits = direct_hits(projector, Aperture(), points, normals, np.arange(2), [screen])
    assert hits.sample.tolist() == [0]


def test_a_flat_pane_displaces_a_ray_as_in_the_textbook() -> None:
    pane = Pane(1.0, 0.05, 1.5, NO_WAVES, coating=0.0)
    for angle in (0.0, 0.3, 0.9):
        ray = np.array([[np.sin(angle), 0, np.cos(angle)]])
        at, leaving, share = pane.through(np.zeros((1, 3)), ray)
        assert leaving == pytest.approx(ray, abs=1e-12)
        straight = 1.05 * np.tan(angle)
        aside = (straight - at[0, 0]) * np.cos(angle)
        inner = np.sqrt(1.5**2 - np.sin(angle) ** 2)
        assert aside == pytest.approx(0.05 * np.sin(angle) * (1 - np.cos(angle) / inner), abs=1e-12)
        assert share == pytest.approx(1)


def test_a_ghost_comes_from_two_faces_further_on() -> None:
    pane = Pane(1.0, 0.05, 1.5, NO_WAVES, coating=0.1)
    angle = 0.4
    ray = np.array([[np.sin(angle), 0, np.cos(angle)]])
    (straight, _, share), (ghost, leaving, faint) = (
        pane.through(np.zeros((1, 3)), ray, ghost=g) for g in (False, True)
    )
    assert (share[0], faint[0]) == pytest.approx((0.9**2, 0.9**2 * 0.1**2))
    assert leaving == pytest.approx(ray, abs=1e-12)
    assert ghost[0, 0] - straight[0, 0] == pytest.approx(2 * 0.05 * np.tan(np.arcsin(np.sin(angle) / 1.5)))


def test_bumps_are_met_and_bend_by_snell() -> None:
    waves = np.array([[0.004, 20.0, 5.0, 0.3]])
    pane = Pane(1.0, 0.05, 1.5, waves)
    ray = np.array([[0.2, 0.1, 1.0]]) / np.linalg.norm([0.2, 0.1, 1])
    at, normal = pane._front(np.zeros((1, 3)), ray)
    assert at[0, 2] == pytest.approx(1.0 + 0.004 * np.sin(20 * at[0, 0] + 5 * at[0, 1] + 0.3), abs=1e-9)
    inner = refracted(ray, normal, 1 / 1.5)
    sines = [np.linalg.norm(np.cross(each, normal)) for each in (ray, inner)]
    assert sines[0] == pytest.approx(1.5 * sines[1])
    assert np.linalg.norm(inner) == pytest.approx(1)


def test_fresnel_at_known_angles() -> None:
    assert fresnel(np.array([1.0]), 1 / 1.5) == pytest.approx(0.04)
    brewster = np.cos(np.arctan(1.5))
    across = ((1 - 1.5**2) / (1 + 1.5**2)) ** 2  # light polarised along the other axis is not reflected
    assert fresnel(np.array([brewster]), 1 / 1.5) == pytest.approx(across / 2)


def test_light_through_a_pane_that_does_nothing_is_light_without_it(rng: np.random.Generator) -> None:
    projector = looking((-0.4, -0.2, 0.0), (0.0, 0.0, 2.0), 30.0, (18, 22))
    behind = square([-1, -1, 2], [2, 0, 0], [0, 2, 0])
    shares = 0.5 + rng.uniform(-0.15, 0.15, (500, 2))
    through = light_behind(Pane(1.5, 0.02, 1.0, NO_WAVES), projector, behind, shares * 2, np.arange(500), ghost=False)
    normals = np.broadcast_to(behind.normal, (500, 3))
    straight = direct_hits(projector, Aperture(), behind.point(shares), normals, np.arange(500), [])
    order = np.argsort(through.sample)
    assert np.array_equal(through.sample[order], straight.sample)
    assert through.uv[order] == pytest.approx(
        straight.uv, abs=5e-3
    )  # straight lines within triangles a quarter pixel wide
    assert through.irradiance[order] == pytest.approx(straight.irradiance, rel=0.02)  # one value per triangle


def test_a_bumpy_pane_moves_light_and_loses_none(rng: np.random.Generator) -> None:
    projector = looking((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 30.0, (12, 12))
    behind = square([-1, -1, 2], [2, 0, 0], [0, 2, 0])
    n = 400
    grid = (np.arange(n) + rng.uniform(0.2, 0.8)) * 2 / n
    y, x = (each.ravel() for each in np.meshgrid(grid, grid, indexing="ij"))
    points, numbers = np.stack([x, y], axis=1), np.arange(n * n)
    waves = np.array([[0.002, 30.0, 8.0, 0.5], [0.002, -10.0, 28.0, 1.5]])
    totals = []
    for pane in (Pane(1.5, 0.02, 1.0, NO_WAVES, 0.0), Pane(1.5, 0.02, 1.5, waves, 0.0)):
        W = footprints(light_behind(pane, projector, behind, points, numbers, ghost=False), n * n, (12, 12))
        totals.append(W.sum())
    assert totals[1] == pytest.approx(totals[0], rel=5e-3)  # means of 160 000 samples
