"""Light between matt surfaces: closed forms and independent recomputation."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from counterlight.tools.simulation.cells import Grid, cut_into_cells
from counterlight.tools.simulation.effects.inter_reflection import form_factors, mean_albedo, mixed, point_to_polygon
from counterlight.tools.simulation.geometry import trace
from counterlight.tools.simulation.needs import needs_of
from counterlight.tools.simulation.projector_side import irradiance
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.transport.transport import FarLight, channel
from tests.scenes import flat, plane, rectangle, scene_file, small

FloatArray = NDArray[np.float64]


# Form factors


def parallel_squares(side: float, distance: float) -> float:
    """Return two aligned parallel squares (Howell's catalogue C-11)."""
    x = side / distance
    root = np.sqrt(1 + x**2)
    inner = (
        np.log(np.sqrt((1 + x**2) ** 2 / (1 + 2 * x**2))) + 2 * x * root * np.arctan(x / root) - 2 * x * np.arctan(x)
    )
    return float(2 / (np.pi * x**2) * inner)


def cells_and_factors(scene: Scene) -> tuple[list[Grid], FloatArray]:
    grids = cut_into_cells(scene.surfaces, scene.cells)
    return grids, form_factors(scene.surfaces, grids)


def far_light(scene: Scene) -> FarLight:
    far = simulate(scene).transport.far
    assert far is not None
    return far


def total_factor(scene: Scene) -> float:
    """Return the form factor from the first surface as a whole to the second, from the cells' factors."""
    grids, factors = cells_and_factors(scene)
    first, second = grids
    return float(factors[: first.count, second.first :].sum(axis=1).mean())


def test_parallel_squares(tmp_path: Path) -> None:
    below = rectangle([-0.5, -0.5, 0], [1, 0, 0], [0, 1, 0])
    above = rectangle([-0.5, -0.5, 3], [1, 0, 0], [0, 1, 0])
    scene = load_scene(scene_file(tmp_path, below + above))
    # The camera stands between the surfaces, so each surface faces it.
    assert total_factor(replace(scene, cells=200)) == pytest.approx(
        parallel_squares(1, 3), rel=2e-3
    )  # error of 3×3 points per cell


def test_perpendicular_squares_that_share_an_edge(tmp_path: Path) -> None:
    floor = rectangle([0, 0, 0], [0, 0, 1], [1, 0, 0])
    wall = rectangle([0, 0, 0], [0, 1, 0], [1, 0, 0])
    scene = load_scene(scene_file(tmp_path, floor + wall))
    fronts = np.array([[0.0, 1, 0], [0.0, 0, 1]])
    surfaces = tuple(
        replace(surface, shape=replace(flat(scene, i), normal=fronts[i])) for i, surface in enumerate(scene.surfaces)
    )
    scene = replace(scene, surfaces=surfaces, cells=800)
    assert total_factor(scene) == pytest.approx(0.20004, rel=5e-3)  # Howell's catalogue C-14; 3×3 points at the edge


def test_a_point_in_a_closed_box_sees_nothing_else(rng: np.random.Generator) -> None:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [1, 5, 7, 3]]  # all but z = 0
    point = np.array([[*rng.uniform(0.1, 0.9, 2), 0.0]])
    total = sum(point_to_polygon(point, np.array([0, 0, 1.0]), corners[face][None])[0] for face in faces)
    assert total == pytest.approx(1, abs=1e-12)  # the formula is exact


def test_reciprocity_and_energy_of_the_corner() -> None:
    scene = replace(small("corner"), cells=120)
    grids, factors = cells_and_factors(scene)
    areas = np.concatenate([grid.areas for grid in grids])
    exchange = areas[:, None] * factors
    far = np.abs(exchange - exchange.T).max() / exchange.max()
    assert far < 0.06  # error of 3×3 points per cell; the worst cells touch at the fold
    assert factors.sum(axis=1).max() < 1


def test_bounces_are_the_geometric_series(rng: np.random.Generator) -> None:
    factors = rng.uniform(0, 0.1, (6, 6))
    albedo = rng.uniform(0.2, 0.9, (6, 3))
    M = mixed(factors, albedo)
    for i in range(3):
        reflect = np.diag(albedo[:, i])
        series, term = np.zeros((6, 6)), factors @ reflect
        for _ in range(200):
            series, term = series + term, factors @ reflect @ term
        # the spectral radius is below 0.6, and 0.6²⁰⁰ is negligible
        np.testing.assert_allclose(M[i], series, rtol=1e-10)


# Direct light


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_a_plane_has_the_radiance_of_the_closed_form(tmp_path: Path, tilt: float) -> None:
    """L = ρ · brightness · (z₀/z)² · cos θ / cos α at the pixel's centre."""
    scene = load_scene(scene_file(tmp_path, plane(tilt=tilt)))
    image = simulate(scene).transport.composition().reshape(14, 20, 3)
    for y, x in ((0, 0), (6, 9), (13, 2), (5, 19)):
        across = (2 * (x + 0.5) / 20 - 1) * np.tan(np.radians(10))
        down = (2 * (y + 0.5) / 14 - 1) * np.tan(np.radians(10)) * 14 / 20
        ray = np.array([across, -down, -1.0])
        normal = np.array([-tilt, 0, 1.0]) / np.hypot(tilt, 1)
        depth = -(normal @ [0, 0, 2.0]) / (normal @ ray)
        cos_surface = -(ray @ normal) / np.linalg.norm(ray)
        expected = (2 / depth) ** 2 * cos_surface * np.linalg.norm(ray)
        # error of 4×4 rays per pixel
        np.testing.assert_allclose(image[y, x], expected * np.array([0.5, 0.6, 0.7]), rtol=2e-3)


def test_a_white_card_has_the_brightness_and_light_falls_with_the_square(tmp_path: Path) -> None:
    white = "albedo = [1, 1, 1]"
    values = {}
    for z in (0.0, -2.0):
        scene = load_scene(scene_file(tmp_path, plane(z, extra=white), projector="brightness = 3.0", fov="60"))
        values[z] = simulate(scene).transport.composition().reshape(14, 20, 3)[7, 10, 1]
    assert values[0.0] == pytest.approx(3.0, rel=1e-5)  # rounding to float32
    assert values[-2.0] == pytest.approx(3.0 / 4, rel=1e-5)


def test_the_wall_is_warped_as_its_homography_says() -> None:
    scene = small("wall", (54, 96), (48, 80))
    T = channel(simulate(scene).transport.near, 1).tocoo()
    weights = T.data / np.bincount(T.coords[0], T.data, T.shape[0])[T.coords[0]]
    seen_x = np.bincount(T.coords[0], weights * (T.coords[1] % 80 + 0.5), T.shape[0])
    seen_y = np.bincount(T.coords[0], weights * (T.coords[1] // 80 + 0.5), T.shape[0])
    corners = np.array([[x, y, 0.0] for x in (-0.4, 0.4) for y in (-0.2, 0.2)])  # four points of the plane z = 0
    from_camera = np.stack(scene.camera.project(corners)[:2], axis=1)
    from_projector = np.stack(scene.projector.project(corners)[:2], axis=1)
    H = homography(from_camera, from_projector)
    y, x = np.divmod(np.arange(T.shape[0]), 96)
    mapped = np.stack([x + 0.5, y + 0.5, np.ones_like(x)], axis=1) @ H.T
    mapped = mapped[:, :2] / mapped[:, 2:]
    inside = np.all((mapped > 1) & (mapped < [79, 47]), axis=1)
    assert inside.mean() > 0.9
    # a pixel is a box of width 1
    assert np.abs(mapped[inside] - np.stack([seen_x, seen_y], axis=1)[inside]).max() < 0.6
    angle = np.abs(H / H[2, 2] - np.eye(3))[2, :2].max()
    assert angle > 1e-4  # the warp is a true perspective


def homography(source: FloatArray, target: FloatArray) -> FloatArray:
    rows = []
    for (x, y), (u, v) in zip(source, target, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y, -u], [0, 0, 0, x, y, 1, -v * x, -v * y, -v]]
    return np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)


def test_shadows_are_cast(tmp_path: Path) -> None:
    screen = rectangle([-0.1, -0.1, 1.0], [0.2, 0, 0], [0, 0.2, 0], 0.5)
    path = scene_file(tmp_path, plane() + screen)
    scene = load_scene(path)
    assert needs_of(scene)["shadows"].on
    # the camera sees behind the card
    moved = replace(scene, camera=replace(scene.camera, position=np.array([0.5, 0.0, 2.0])))
    lit = channel(simulate(moved).transport.near, 0).sum(axis=1).reshape(14, 20)
    assert (lit == 0).any()
    assert (lit > 0).any()


# Inter-reflection


def test_the_floodlit_corner_equals_bounces_computed_one_by_one() -> None:
    """Iterated radiosity from the direct light on the cells, read by each camera ray, agrees."""
    scene = replace(small("corner", (14, 24), (12, 20)), cells=60, samples=2)
    far = far_light(scene)
    grids, factors = cells_and_factors(scene)
    direct = channel(far.gather, 0) @ np.ones(channel(far.gather, 0).shape[1])
    albedo = np.concatenate([mean_albedo(grid) for grid in grids])[:, 0]
    indirect = np.zeros_like(direct)
    for _ in range(100):
        indirect = factors @ (albedo * (direct + indirect))
    directions, pixels = scene.camera.pixel_rays(range(14), 2)
    hits = trace(scene.camera.position, directions, scene.surfaces)
    expected = np.zeros(14 * 24)
    for index, grid in enumerate(grids):
        on = hits.surface == index
        rho = grid.surface.material.albedo(hits.u[on], hits.v[on])[:, 0]
        cells = indirect[grid.numbers].reshape(grid.along, grid.across)
        x = np.clip(hits.u[on] * grid.across - 0.5, 0, grid.across - 1)
        y = np.clip(hits.v[on] * grid.along - 0.5, 0, grid.along - 1)
        i, j = np.minimum(x.astype(int), grid.across - 2), np.minimum(y.astype(int), grid.along - 2)
        upper = cells[j, i] * (1 - x + i) + cells[j, i + 1] * (x - i)
        lower = cells[j + 1, i] * (1 - x + i) + cells[j + 1, i + 1] * (x - i)
        seen = rho * (upper * (1 - y + j) + lower * (y - j)) / np.pi / 4
        expected += np.bincount(pixels[on], seen, expected.size)
    result = channel(far.scatter, 0) @ (far.mix.matrices[0] @ direct)
    np.testing.assert_allclose(result, expected, rtol=1e-5)  # U is float32
    assert result.max() > 0.05


def test_every_projector_pixel_carries_the_same_flux() -> None:
    """The light that lands on the cells equals the even light sent. Direct and far light share one unit."""
    scene = replace(small("corner"), cells=120)
    far = far_light(scene)
    grids = cut_into_cells(scene.surfaces, scene.cells)
    areas = np.concatenate([grid.areas for grid in grids])
    flux = areas @ channel(far.gather, 0)
    assert flux.max() == pytest.approx(np.median(flux), rel=1e-9)
    direct = channel(far.gather, 0) @ np.ones(channel(far.gather, 0).shape[1])
    for grid in grids:
        inside = grid.numbers
        points, normals = grid.points.reshape(-1, 3), grid.normals.reshape(-1, 3)
        x, y, _ = scene.projector.project(points)
        whole = ((x > 0) & (x < 40) & (y > 0) & (y < 24)).reshape(grid.count, -1).all(axis=1)
        exact = irradiance(scene, points, normals).reshape(grid.count, -1).mean(axis=1)
        assert whole.sum() > 10
        # About 30 beams hit a cell, so one more row of beams changes it by 15 %. The average agrees.
        np.testing.assert_allclose(direct[inside][whole], exact[whole], rtol=0.35)
        assert direct[inside][whole].mean() == pytest.approx(exact[whole].mean(), rel=0.02)


def test_no_room_returns_more_than_it_gets() -> None:
    """Two white cards: the radiosity converges, unlike in a closed white room, and the far light is positive."""
    scene = small("corner")
    result = simulate(scene)
    assert result.transport.far is not None
    lost = 1 - result.transport.far.mix.matrices.sum(axis=2)  # indirect light per unit of uniform direct light
    assert lost.max() < 1
    assert channel(result.transport.near, 0).data.min() >= 0
    assert result.transport.far.mix.matrices.min() >= 0
