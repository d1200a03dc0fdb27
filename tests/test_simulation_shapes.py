"""Shapes: ray intersections, compared with each other and with closed forms."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.tools.simulation.geometry import blocked, trace
from counterlight.tools.simulation.materials import Pattern
from counterlight.tools.simulation.scene import inside_of, load_scene
from counterlight.tools.simulation.shapes import mesh
from counterlight.tools.simulation.shapes.figures import bricks
from counterlight.tools.simulation.shapes.mesh import read_obj
from counterlight.tools.simulation.shapes.parallelogram import Parallelogram
from counterlight.tools.simulation.shapes.quadrics import Cylinder, Sphere
from counterlight.tools.simulation.shapes.shape import Shape, shape_area
from counterlight.tools.simulation.shapes.triangles import Triangles, read_heights, relief, turned
from tests.scenes import plane, scene_file

FloatArray = NDArray[np.float64]
X, Y, Z = np.eye(3)
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
CUBE = """
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
f 4 3 2 1
f 5 6 7 8
f 1 2 6 5
f 3 4 8 7
f 2 3 7 6
f 1 5 8 4
"""


def turned_sphere(radius: float, rings: int) -> Triangles:
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)
    profile = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    profile[[0, -1], 0] = 0
    return turned(np.zeros(3), Y, (X, -Z), profile, 2 * rings)


def hilly() -> Triangles:
    u, v = np.meshgrid(np.linspace(0, 1, 81), np.linspace(0, 1, 61))
    base = Parallelogram(np.array([-1.0, -0.8, -0.2]), 2 * X, 1.6 * Y, Z)
    return relief(base, 0.3 * np.sin(3 * u) * np.cos(4 * v) + 0.3, cut=False)


SHAPES: dict[str, Callable[[], Shape]] = {
    "plane": lambda: Parallelogram(np.array([-0.7, -0.6, 0.1]), 1.4 * X + 0.3 * Y, 1.2 * Y + 0.1 * X, Z),
    "sphere": lambda: Sphere(np.array([0.1, -0.1, 0.05]), 0.8),
    "cylinder": lambda: Cylinder(np.array([0.1, -0.6, 0.0]), 1.1 * Y, 0.5, X, -Z),
    "relief": hilly,
    "lathe": lambda: turned_sphere(0.8, 24),
}


def rays_at(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    """Return origins on a sphere of radius 3, and directions of any length to points near the origin."""
    origins = rng.normal(size=(count, 3))
    origins *= 3 / np.linalg.norm(origins, axis=1, keepdims=True)
    return origins, (rng.uniform(-0.6, 0.6, (count, 3)) - origins) * rng.uniform(0.1, 2, (count, 1))


@pytest.mark.parametrize("name", SHAPES)
def test_what_a_ray_meets_is_the_place_it_names(name: str, rng: np.random.Generator) -> None:
    shape = SHAPES[name]()
    origins, directions = rays_at(rng, 400)
    met = shape.meet(origins, directions)
    assert met.ray.size > 100
    points = origins[met.ray] + met.distance[:, None] * directions[met.ray]
    # Lathes and reliefs are cut into triangles, while at() is bilinear; the two differ by the twist of a field.
    close = 4e-3 if isinstance(shape, Triangles) else 1e-12
    np.testing.assert_allclose(shape.at(met.u, met.v), points, atol=close)
    np.testing.assert_allclose(np.linalg.norm(met.normal, axis=1), 1, rtol=1e-12)
    step = 1e-5
    inner = (np.abs(met.u - 0.5) < 0.49) & (np.abs(met.v - 0.5) < 0.47)
    du, dv = (shape.at(met.u + s, met.v + t) - shape.at(met.u - s, met.v - t) for s, t in ((step, 0), (0, step)))
    across = np.cross(du, dv)[inner]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    aligned = np.abs(np.sum(across * met.normal[inner], axis=1))
    assert aligned.min() > (0.99 if isinstance(shape, Triangles) else 1 - 1e-8)


@pytest.mark.parametrize("name", SHAPES)
def test_what_blocks_is_what_is_met(name: str, rng: np.random.Generator) -> None:
    shape = SHAPES[name]()
    origins, directions = rays_at(rng, 400)
    distance = np.full(400, np.inf)
    met = shape.meet(origins, directions)
    distance[met.ray] = met.distance
    sure = np.abs(distance - 1) > 1e-3  # not near the segment's end, where float32 decides
    np.testing.assert_array_equal(shape.blocks(origins, directions)[sure], (distance < 1)[sure])


def test_a_sphere_of_triangles_is_a_sphere(rng: np.random.Generator) -> None:
    exact, cut = Sphere(np.zeros(3), 0.8), turned_sphere(0.8, 128)
    origins, directions = rays_at(rng, 2000)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    a, b = exact.meet(origins, directions), cut.meet(origins, directions)
    both, i, j = np.intersect1d(a.ray, b.ray, return_indices=True)
    facing = np.abs(np.sum(a.normal[i] * directions[both], axis=1)) > 0.2
    sagitta = 0.8 * (np.pi / 256) ** 2  # sagitta of one field; twice as much for the two diagonals
    assert np.abs(a.distance[i] - b.distance[j])[facing].max() < 2 * sagitta / 0.2
    assert np.sum(a.normal[i] * b.normal[j], axis=1)[facing].min() > 0.999  # the normals of both shapes point outwards
    assert set(b.ray) <= set(a.ray)


def test_areas() -> None:
    assert shape_area(SHAPES["sphere"]()) == pytest.approx(4 * np.pi * 0.8**2, rel=1e-12)
    side, caps = 2 * np.pi * 0.5 * 1.1, 2 * np.pi * 0.5**2
    assert shape_area(SHAPES["cylinder"](), 63) == pytest.approx(side + caps, rel=1e-3)  # 63 rows, 21 for each part
    cone = turned(np.zeros(3), Y, (X, -Z), np.array([[0.3, 0.0], [0.0, 0.4]]), 512)
    assert cone.face_areas.sum() == pytest.approx(np.pi * 0.3 * 0.5, rel=1e-4)
    flat = relief(Parallelogram(np.zeros(3), 2 * X, 3 * Y, Z), np.full((5, 7), 0.2), cut=False)
    assert flat.face_areas.sum() == pytest.approx(6, rel=1e-12)


def test_a_relief_rises_towards_the_camera_and_is_cut_where_it_is_flat(tmp_path: Path) -> None:
    text = """
        [[surfaces]]
        shape = "relief"
        corner = [1, -1, 0]
        edge_u = [-2, 0, 0]
        edge_v = [0, 2, 0]
        figure = "statuette"
        height = 0.3
        cut = true
        albedo = [0.5, 0.5, 0.5]
    """
    scene = load_scene(scene_file(tmp_path, text))
    hits = trace(np.array([0, 0, 2.0]), np.array([[0.0, -0.1, -1], [0.48, 0.48, -1]]), scene.surfaces)
    np.testing.assert_array_equal(hits.surface, [0, -1])  # one ray hits the chest, the other passes the head
    assert 1.65 < hits.distance[0] < 1.9
    assert hits.front[0]


def test_heights_from_a_picture(tmp_path: Path) -> None:
    ramp = np.tile(np.linspace(65535, 0, 40).astype(np.uint16)[:, None], (1, 30))  # white at the top
    cv2.imwrite(str(tmp_path / "ramp.png"), ramp)
    heights = read_heights(tmp_path / "ramp.png", "here", 16, 21)
    assert heights.shape == (21, 16)
    assert heights[0, 0] < 0.03 < 0.97 < heights[-1, 0]  # row 0 is at v = 0, the bottom
    with pytest.raises(InputError, match=r"here: .*none.png: missing"):
        read_heights(tmp_path / "none.png", "here", 4, 4)


def test_a_mesh_is_read_and_met(tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(CUBE)
    # scaled by 2 and moved by (1, 0, 0), to (3, 2, 2)
    cube = read_obj(tmp_path / "cube.obj", "here", np.array([1.0, 0, 0]), 2.0)
    assert cube.closed
    met = cube.meet(np.array([[0.0, 1, 0.9], [2, 5, 1.1], [9, 9, 9]]), np.array([X, -Y, X]))
    np.testing.assert_array_equal(met.ray, [0, 1])
    np.testing.assert_allclose(met.distance, [1, 3])
    np.testing.assert_allclose(met.normal, [-X, Y], atol=1e-12)
    (tmp_path / "open.obj").write_text(CUBE.replace("f 1 5 8 4\n", ""))
    assert not read_obj(tmp_path / "open.obj", "here", np.zeros(3), 1.0).closed


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("v 0 0 0\n", "no faces"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "whose v is not there"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/1 3/1\n", "whose vt is not there"),
        ("v 0 0 zero\n", "line 1: could not convert"),
        ("v 0 0\n", "line 1: 3 finite numbers expected"),
        ("v 0 0 nan\n", "line 1: 3 finite numbers expected"),
        (TRIANGLE + "f 1 2 -4\n", "whose v is not there"),
        (TRIANGLE + f"f 1 2 {10**30}\n", "line 4: int too big"),
        (TRIANGLE + f"f 1 2 {'9' * 5000}\n", "line 4: Exceeds the limit"),
        (TRIANGLE + "f 1 2" + " 3" * 40000, "line 4: 80005 bytes, at most 65536 are read"),
        (TRIANGLE + "f 1 2 3 1 2 3 1\n", "line 4: more than 4 triangles"),
        ("v 0 0 0\nv 1e300 0 0\nv 0 1e300 0\nf 1 2 3\n", "a vertex beyond 1e.06 metres"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no face with an area"),
        (TRIANGLE + "vn 0 0 0\nf 1//1 2//1 3//1\n", "a normal without a direction"),
        (TRIANGLE + "vn 1e200 1e200 0\nf 1//1 2//1 3//1\n", "a normal without a direction"),
        ("\0" * 5000 + "v 1\n", "no faces"),
        ("v " + "x" * 5000 + " 0 0\n", r"line 1: could not convert .{0,200}$"),
    ],
)
def test_broken_meshes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str, complaint: str) -> None:
    monkeypatch.setattr(mesh, "MAX_TRIANGLES", 4)
    (tmp_path / "broken.obj").write_text(content)
    with pytest.raises(InputError, match=rf"here: .*broken.obj.*{complaint}"):
        read_obj(tmp_path / "broken.obj", "here", np.zeros(3), 1.0)


def test_the_nearest_of_several_surfaces_is_met_and_all_of_them_block(tmp_path: Path) -> None:
    ball = '[[surfaces]]\nshape = "sphere"\ncentre = [0, 0, 0.5]\nradius = 0.2\nalbedo = [0.5, 0.5, 0.5]\n'
    scene = load_scene(scene_file(tmp_path, plane() + ball))
    hits = trace(np.array([0, 0, 2.0]), np.array([[0, 0, -1.0], [1, 0, -1.0], [0, 0, 1.0]]), scene.surfaces)
    np.testing.assert_array_equal(hits.surface, [1, 0, -1])
    np.testing.assert_allclose(hits.point[0], [0, 0, 0.7])
    ends = np.array([[0, 0, 0.0], [1, 0, 0.0], [0, 0, 0.7]])
    np.testing.assert_array_equal(blocked(ends, np.array([0, 0, 2.0]), scene.surfaces), [True, False, False])
    assert inside_of(scene, np.array([0.1, 0, 0.5])) is scene.surfaces[1]
    assert inside_of(scene, np.array([0, 0, 2.0])) is None


def test_bricks_stand_out_where_the_pattern_has_bricks(rng: np.random.Generator) -> None:
    u, v = rng.uniform(size=(2, 5000))
    repeat = float(bricks.BRICKS), float(bricks.COURSES)
    painted = Pattern("bricks", np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]), repeat, 0.0).albedo(u, v)[:, 0]
    heights = bricks.heights(u, v)
    assert 0 < painted.mean() < 1
    assert np.all((heights == 0) | (painted == 1))  # mortar lies deep in the wall
    assert np.median(heights[painted == 1]) > 0.5
    assert heights.min() == 0
    assert 0.8 < heights.max() <= 1
    assert np.std(heights[heights > 0.6]) > 0.03  # bricks are rough
