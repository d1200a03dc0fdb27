"""Laws for the light of every room: conservation, reciprocity, linearity, and a rendering without T."""

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray

from counterlight.tools.simulation.cells import cut_into_cells
from counterlight.tools.simulation.devices import Device
from counterlight.tools.simulation.effects.inter_reflection import form_factors, mixed
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.transport.transport import channel, channel_of_chain
from tests.scenes import flat, plane, rectangle, scene_file, small

FloatArray = NDArray[np.float64]
D = TypeVar("D", bound=Device)
FACES = (  # a closed box around the origin: corner and edges of each face
    ([-1, -1, -1], [2, 0, 0], [0, 2, 0]),
    ([-1, -1, 1], [2, 0, 0], [0, 2, 0]),
    ([-1, -1, -1], [0, 2, 0], [0, 0, 2]),
    ([1, -1, -1], [0, 2, 0], [0, 0, 2]),
    ([-1, -1, -1], [0, 0, 2], [2, 0, 0]),
    ([-1, 1, -1], [0, 0, 2], [2, 0, 0]),
)


def box(tmp_path: Path, albedo: float, cells: int = 300) -> Scene:
    """Return a closed Lambertian box of side 2 with projector and camera inside."""
    text = "".join(rectangle(*face, albedo) for face in FACES)  # type: ignore[arg-type]
    path = scene_file(tmp_path, text, fov="80")
    path.write_text(path.read_text().replace("position = [0, 0, 2]", "position = [0.1, 0.2, 0.3]"))
    return replace(load_scene(path), cells=cells)


def test_in_a_closed_box_bounces_are_the_geometric_series(tmp_path: Path) -> None:
    """Even light E on walls of albedo ρ: each bounce returns the share ρ, so H = E (ρ + ρ² + …) = E ρ / (1 − ρ)."""
    scene = box(tmp_path, 0.7)
    factors = form_factors(scene.surfaces, cut_into_cells(scene.surfaces, scene.cells))
    assert factors.sum(axis=1).max() <= 1 + 1e-12
    np.testing.assert_allclose(factors.sum(axis=1), 1, atol=3e-3)  # nine points for near cells, one point for far cells
    H = mixed(factors, np.full((len(factors), 3), 0.7)).sum(axis=2)
    np.testing.assert_allclose(H, 0.7 / 0.3, rtol=3e-3 / 0.3)  # the error of a bounce, times 1 / (1 − ρ)


def test_a_closed_box_absorbs_what_is_sent(tmp_path: Path) -> None:
    """The walls keep Σ A (1 − ρ) (E + H) of direct and indirect light, which is the projector's flux."""
    scene = box(tmp_path, 0.8)
    far = simulate(scene).transport.far
    assert far is not None
    areas = np.concatenate([grid.areas for grid in cut_into_cells(scene.surfaces, scene.cells)])
    for picture in [*np.eye(16 * 12)[[0, 50, 191]].tolist(), np.ones(16 * 12).tolist()]:
        direct = channel(far.gather, 1) @ np.array(picture)
        kept = areas @ (0.2 * (direct + far.mix.matrices[1] @ direct))
        sent = areas @ direct
        assert sent > 0
        assert kept == pytest.approx(sent, rel=0.02)  # neighbours at an edge are reciprocal within 6 %


def test_one_pixel_sends_the_flux_of_the_even_light(tmp_path: Path) -> None:
    """The flux is π · brightness · z₀² times the pixel's area at depth 1. A plane's irradiance has the same sum."""
    scene = box(tmp_path, 0.8)
    far = simulate(scene).transport.far
    assert far is not None
    areas = np.concatenate([grid.areas for grid in cut_into_cells(scene.surfaces, scene.cells)])
    pitch = 2 * np.tan(np.radians(40)) / 16
    distance = np.linalg.norm([0.1, 0.2, 0.3])
    np.testing.assert_allclose(areas @ channel(far.gather, 0), np.pi * distance**2 * pitch**2, rtol=1e-12)


def test_a_ball_over_a_small_card(tmp_path: Path) -> None:
    """From a small area to a ball of radius R with its centre at height h above it: F = (R/h)²."""
    ball = '[[surfaces]]\nshape = "sphere"\ncentre = [0, 0, 1.2]\nradius = 0.4\nalbedo = [0.5, 0.5, 0.5]\n'
    card = rectangle([-0.05, -0.05, 0], [0.1, 0, 0], [0, 0.1, 0])
    scene = load_scene(scene_file(tmp_path, card + ball))
    grids = cut_into_cells(scene.surfaces, 900)
    factors = form_factors(scene.surfaces, grids)
    to_ball = factors[grids[0].numbers, grids[1].numbers].sum(axis=1)
    np.testing.assert_allclose(to_ball, (0.4 / 1.2) ** 2, rtol=0.02)  # cells at the ball's outline are partly cut off
    areas = np.concatenate([grid.areas for grid in grids])
    exchange = areas[:, None] * factors
    np.testing.assert_allclose(exchange, exchange.T, atol=1e-15)  # reciprocal by construction
    assert not factors[grids[1].numbers, grids[1].numbers].any()  # a ball does not see itself


def test_a_card_of_triangles_is_a_card(tmp_path: Path) -> None:
    """One card of the corner becomes a mesh.

    Direct light agrees to rounding, far light within the error of point sampling.
    """
    scene = replace(small("corner"), cells=250)
    card = flat(scene, 0)
    n = 24
    u, v = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1))
    lines = ["v {} {} {}".format(*p) for p in card.at(u, v).reshape(-1, 3)]
    lines += [f"vt {a} {b}" for a, b in zip(u.ravel(), v.ravel(), strict=True)]
    turned = np.cross(card.edge_u, card.edge_v) @ card.normal < 0
    for j in range(n):
        for i in range(n):
            corners = [j * (n + 1) + i, j * (n + 1) + i + 1, (j + 1) * (n + 1) + i + 1, (j + 1) * (n + 1) + i]
            lines.append("f " + " ".join(f"{k + 1}/{k + 1}" for k in (corners[::-1] if turned else corners)))
    (tmp_path / "card.obj").write_text("\n".join(lines))
    mesh = load_scene(scene_file(tmp_path, '[[surfaces]]\nshape = "mesh"\nfile = "card.obj"\nalbedo = [1, 1, 1]\n'))
    other = replace(scene.surfaces[0], shape=mesh.surfaces[0].shape)
    both = [simulate(s).transport for s in (scene, replace(scene, surfaces=(other, scene.surfaces[1])))]
    direct = [channel(T.near, 0).toarray() for T in both]
    different = np.abs(direct[0] - direct[1]) > 1e-5 * direct[0].max()
    assert different.mean() < 1e-4  # rays within float32 of an edge may hit either side
    far = [T.composition()[:, 0] - d.sum(axis=1) for T, d in zip(both, direct, strict=True)]
    assert far[1].sum() == pytest.approx(far[0].sum(), rel=0.03)
    assert np.abs(far[1] - far[0]).max() < 0.15 * far[0].max()


@pytest.mark.parametrize("name", ["corner", "statuette"])
def test_camera_and_projector_can_be_exchanged(name: str) -> None:
    """Helmholtz: exchanging the devices transposes T, up to factors of their pixels.

    T_ij = Σ dA g_c g_p ρ brightness z₀² / a_c, with g of camera and projector alike and a_c the camera pixel's area at
    depth 1 (even light, projector_side.py). So T a_c / z₀² is symmetric under the exchange.
    """
    scene = replace(small(name, (24, 32), (24, 32)), samples=8, cells=200)
    swapped = replace(
        scene,
        camera=moved(scene.camera, scene.projector),
        projector=moved(scene.projector, scene.camera),
    )
    pair = []
    for room in (scene, swapped):
        unit = room.camera.pixel_area / room.projector.target_distance**2
        transport = simulate(room).transport
        probes = blocks(24, 32, 8)
        pair.append(unit * probes.T @ channel(transport.near, 1).toarray() @ probes)
        if transport.far is not None:
            D, M, U = channel_of_chain(transport.far, 1).factors
            far = U @ M @ D.toarray()
            pair[-1] = pair[-1] + unit * probes.T @ far @ probes
    largest = pair[0].max()
    assert np.abs(pair[0] - pair[1].T).max() < 0.02 * largest  # error of 64 rays per pixel, in blocks of 8 x 8 pixels
    assert np.abs(pair[0] - pair[0].T).max() > 0.1 * largest  # a symmetric room would prove nothing


def moved(device: D, place: Device) -> D:
    fields = ("position", "right", "up", "forward", "tan_half", "target_distance", "focus_distance")
    return replace(device, **{name: getattr(place, name) for name in fields})


def blocks(height: int, width: int, size: int) -> FloatArray:
    """Return indicators (pixels, blocks) of blocks of pixels."""
    y, x = np.divmod(np.arange(height * width), width)
    block = (y // size) * (width // size) + x // size
    return np.asarray(block[:, None] == np.arange(block.max() + 1), np.float64)


def test_the_room_is_linear_in_the_picture_and_in_the_paint(rng: np.random.Generator) -> None:
    scene = small("corner")
    transport = simulate(scene).transport
    p, q = rng.uniform(size=(2, transport.shape[1], 3))
    np.testing.assert_allclose(transport.apply(2 * p + 3 * q), 2 * transport.apply(p) + 3 * transport.apply(q))
    bright = simulate(replace(scene, projector=replace(scene.projector, brightness=2.5))).transport
    np.testing.assert_allclose(bright.apply(p), 2.5 * transport.apply(p), rtol=1e-5)  # rounding to float32


def test_floodlight_rendered_pixel_by_pixel(tmp_path: Path) -> None:
    """A ball and its shadow on a plane, rendered ray by ray with independent formulas: no T, no shapes, no bands."""
    ball = '[[surfaces]]\nshape = "sphere"\ncentre = [0.1, 0.05, 0.6]\nradius = 0.15\nalbedo = [0.9, 0.5, 0.3]\n'
    path = scene_file(tmp_path, plane(tilt=0.2) + ball + "[ambient]\nirradiance = [0.3, 0.2, 0.1]\n")
    path.write_text(path.read_text().replace("position = [0, 0, 2]", "position = [0.4, 0.3, 2]", 1))
    scene = load_scene(path)
    assert scene.projector.position[0] == 0.4
    scene = replace(scene, samples=2, projector=replace(scene.projector, black_level=0.01))
    result = simulate(scene, without=["inter_reflection"])
    expected = np.array([[rendered(x, y) for x in range(20)] for y in range(14)])
    composition = result.transport.composition().reshape(14, 20, 3)
    np.testing.assert_allclose(composition, expected[..., 0], rtol=1e-5, atol=1e-6)  # rounding to float32
    np.testing.assert_allclose(result.ambient, expected[..., 1] + 0.01 * expected[..., 0], rtol=1e-5)


LIGHT, EYE = np.array([0.4, 0.3, 2.0]), np.array([0.0, 0.0, 2.0])
CENTRE, RADIUS = np.array([0.1, 0.05, 0.6]), 0.15


def rendered(x: int, y: int) -> FloatArray:
    """Return radiance (3, [white, ambient light]) of one camera pixel, the mean of 2 × 2 rays."""
    total = np.zeros((3, 2))
    half = np.tan(np.radians(10))
    for sx in (0.25, 0.75):
        for sy in (0.25, 0.75):
            ray = np.array([(2 * (x + sx) / 20 - 1) * half, -(2 * (y + sy) / 14 - 1) * half * 14 / 20, -1.0])
            to_ball = first_meeting(EYE, ray)
            if to_ball is None:
                normal, paint = np.array([-0.2, 0, 1.0]) / np.hypot(0.2, 1), np.array([0.5, 0.6, 0.7])
                point = EYE + ray * (-(EYE @ normal) / (ray @ normal))  # the plane goes through the origin
            else:
                point, paint = EYE + to_ball * ray, np.array([0.9, 0.5, 0.3])
                normal = (point - CENTRE) / RADIUS
            total[:, 0] += paint / np.pi * light_at(point, normal) / 4
            total[:, 1] += paint / np.pi * np.array([0.3, 0.2, 0.1]) / 4
    return total


def first_meeting(start: FloatArray, ray: FloatArray) -> float | None:
    """Return where a ray meets the ball, in ray lengths, from the triangle of centre, foot and meeting point."""
    length = float(np.linalg.norm(ray))
    foot = float((CENTRE - start) @ ray) / length
    height = float(np.linalg.norm(start + foot * ray / length - CENTRE))
    if height >= RADIUS or foot <= 0:
        return None
    return (foot - np.sqrt(RADIUS**2 - height**2)) / length


def light_at(point: FloatArray, normal: FloatArray) -> float:
    """Return the irradiance of an even picture. The projector looks at the origin, 30° wide and 16 : 12."""
    axis = -LIGHT / np.linalg.norm(LIGHT)
    right = np.cross(axis, [0, 1, 0]) / np.linalg.norm(np.cross(axis, [0, 1, 0]))
    beam = point - LIGHT
    depth = float(beam @ axis)
    half = np.tan(np.radians(15))
    inside = abs(beam @ right) < depth * half and abs(beam @ np.cross(right, axis)) < depth * half * 12 / 16
    cosine = float(-beam @ normal / np.linalg.norm(beam))
    hidden = first_meeting(LIGHT, beam)
    if not inside or cosine <= 0 or (hidden is not None and hidden < 1 - 1e-6):
        return 0.0
    return float(np.pi * (LIGHT @ LIGHT) / depth**2 * cosine * np.linalg.norm(beam) / depth)
