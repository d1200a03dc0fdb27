"""Viewpoints in one room: shares of the views, drives between views, reading and refusals."""

import json
import socket
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.spatial import ConvexHull, Delaunay

from counterlight.errors import InputError
from counterlight.maps.room_maps import RefinementMaps
from counterlight.media.frames import radiance_frame
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.renderer import Renderer
from counterlight.pipeline.views_together import with_shared_darkness
from counterlight.show.control import ControlServer
from counterlight.show.registry import CommandError
from counterlight.viewpoints import Places, Viewpoint
from tests.oracles.renderer import ReferenceRenderer
from tests.refined_rooms import PhysicalRoom
from tests.rooms import CAMERA
from tests.stage import Stage
from tests.viewed_rooms import as_set, letters, two_views

SQUARE = Places(((0, 0), (1, 0), (0, 1), (1, 1)))
LINE = Places(((0.5, 1), (-0.5, 0), (0, 0.5)))
GRID = Places(tuple((float(x), float(y)) for x in range(4) for y in range(3)))


@pytest.mark.parametrize("places", [SQUARE, LINE, GRID, Places(((3, -2),))])
def test_a_viewer_at_a_view_has_that_alone(places: Places) -> None:
    shares = [places.shares((at,)) for at in places.at]
    np.testing.assert_array_equal(shares, np.eye(len(places.at)))  # at the place of a view, no other view contributes


def test_shares_give_the_place_back_and_name_few_views(rng: np.random.Generator) -> None:
    """Shares are barycentric in a triangulation: linear functions are exact, and distant views have share 0."""
    places = Places(tuple(map(tuple, rng.uniform(-2, 3, (12, 2)).tolist())))
    at, hull = np.array(places.at), Delaunay(np.array(places.at))
    inside = [point for point in rng.uniform(-2, 3, (300, 2)) if hull.find_simplex(point) >= 0]
    assert len(inside) > 100
    for point in inside:
        shares = places.shares((tuple(point),))
        assert shares.min() >= 0
        np.testing.assert_allclose(shares @ at, point, atol=1e-5)  # shares below 1e-6 are left out
        corners = hull.simplices[hull.find_simplex(point)]
        assert set(np.flatnonzero(shares)) <= set(corners.tolist())  # scipy's triangulation is the same


@pytest.mark.parametrize("places", [SQUARE, GRID, LINE])
def test_shares_are_continuous(places: Places, rng: np.random.Generator) -> None:
    """Shares are continuous also where four views on a circle have two equally good triangulations.

    The picture never jumps.
    """
    for start in rng.uniform(-1, 4, (30, 2)):
        path = start + np.linspace(0, 1, 200)[:, None] * rng.uniform(-1, 1, 2)
        shares = np.array([places.shares((tuple(point),)) for point in path])
        # a step is at most 0.0072 long, and shares have slopes up to 2
        assert np.abs(np.diff(shares, axis=0)).max() < 0.03


def test_beyond_the_views_counts_the_nearest_place_between_them(rng: np.random.Generator) -> None:
    assert GRID.outside(((1.5, 0.3),)) is None
    assert GRID.outside("all") is None
    assert GRID.outside(((1.5, 0.3), (9, 1))) == "viewpoint 9,1 is outside the views; taken as 3,1"
    places = Places(tuple(map(tuple, rng.uniform(-1, 1, (9, 2)).tolist())))
    corners = np.array(places.at)[ConvexHull(np.array(places.at)).vertices]
    border = np.concatenate(
        [np.linspace(a, b, 2000) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    )
    for angle in np.linspace(0, 6, 13):
        point = 4 * np.array([np.cos(angle), np.sin(angle)])
        nearest = border[((border - point) ** 2).sum(axis=1).argmin()]
        np.testing.assert_allclose(places.shares((tuple(point),)) @ np.array(places.at), nearest, atol=2e-3)


def test_several_viewers_share_and_all_stand_at_the_views() -> None:
    np.testing.assert_allclose(LINE.shares(((0, 0.5), (0.25, 0.75))), [0.25, 0, 0.75])
    np.testing.assert_allclose(LINE.shares("all"), [1 / 3] * 3)


@pytest.fixture(scope="module")
def views() -> list[PhysicalRoom]:
    return two_views()


def drawn(renderer: Renderer, viewpoint: Viewpoint, steps: int) -> np.ndarray:
    frame = letters()
    renderer.open(frame.format)
    renderer.adjust(Adjustments(viewpoint=viewpoint))
    renderer.upload(frame)
    renderer.render("projector", compensate=True, steps=steps)
    return renderer.linear().astype(np.float64)


@pytest.mark.parametrize("steps", [0, 5])
@pytest.mark.parametrize("start", ["previous", "previous-direct", "map", "direct", "grey"])
def test_at_a_view_the_drive_is_that_of_the_view_alone(views: list[PhysicalRoom], start: str, steps: int) -> None:
    room = as_set(views, start)
    for place, view in ((0, 0), (1, 1), (-7, 0)):  # outside the views, the nearest view counts
        alone = drawn(CpuRenderer(replace(views[view].room, start=start)), "all", steps)
        np.testing.assert_array_equal(drawn(CpuRenderer(room), ((place, 0),), steps), alone)


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_between_views_steps_end_at_scipys_answer(views: list[PhysicalRoom], share: float) -> None:
    """Bounded-variable least squares on dense matrices gives min Σ λ ‖T p − b‖² within 0..1."""
    found = drawn(CpuRenderer(as_set(views)), ((share, 0),), 4000).reshape(-1, 3)
    rows, asked = [list[np.ndarray]() for _ in range(3)], [list[np.ndarray]() for _ in range(3)]
    for weight, view in zip((1 - share, share), views, strict=True):
        alone = CpuRenderer(view.room)
        drawn(alone, "all", 0)
        b = np.clip((alone.desired() - view.room.ambient).reshape(-1, 3), 0, view.dense.sum(axis=2).T)
        for i in range(3):
            rows[i].append(np.sqrt(weight) * view.dense[i][view.inside])
            asked[i].append(np.sqrt(weight) * b[view.inside, i])
    for i in range(3):
        T, b = np.concatenate(rows[i]), np.concatenate(asked[i])
        best = lsq_linear(T, b, (0, 1), method="bvls", tol=1e-12)
        error = float(np.sum((T @ found[:, i] - b) ** 2)) / 2
        assert best.cost <= error < best.cost * (1 + 1e-4)  # float32 pictures, 4000 steps


def test_a_pass_over_the_place_moves_the_drive_without_jumps(views: list[PhysicalRoom]) -> None:
    """At 60 Hz a viewer moves little per frame, so the drive changes little, even where another view gets a share."""
    renderer, drives = CpuRenderer(as_set(views)), []
    drawn(renderer, ((0, 0),), 64)
    for place in np.linspace(0, 1, 121):
        renderer.adjust(Adjustments(viewpoint=((float(place), 0),)))
        renderer.upload(letters())
        renderer.render("projector", compensate=True, steps=4)
        drives.append(renderer.linear().astype(np.float64))
    changes = [float(np.sqrt(np.mean((b - a) ** 2))) for a, b in pairwise(drives)]
    whole = float(np.sqrt(np.mean((drives[-1] - drives[0]) ** 2)))
    assert max(changes) < 0.15 * whole  # even motion gives 1/120; a switch between views gives 1


def test_no_certificate_is_given_between_views(views: list[PhysicalRoom]) -> None:
    renderer = CpuRenderer(as_set(views))
    drawn(renderer, ((0.5, 0),), 4)
    assert renderer.certificate() is None
    assert renderer.snapshot() is None
    drawn(renderer, ((1, 0),), 4)
    assert renderer.certificate() is not None


def test_the_view_shown_is_that_of_the_largest_share(views: list[PhysicalRoom]) -> None:
    renderer, frame = CpuRenderer(as_set(views)), letters()
    renderer.open(frame.format)
    for place, view in ((0.4, 0), (0.6, 1)):
        renderer.adjust(Adjustments(viewpoint=((place, 0),)))
        renderer.upload(frame)
        drive = np.zeros((views[0].dense.shape[2], 3))
        renderer.render("projector", compensate=True, steps=3)
        drive[:] = renderer.linear().reshape(-1, 3)
        renderer.render("camera", compensate=True, steps=3)
        seen = views[view].transport.apply(drive).reshape(*CAMERA, 3) + views[view].room.ambient
        np.testing.assert_allclose(renderer.linear(), seen, atol=1e-5)  # float32 sums


def test_the_compiled_renderer_between_views_is_numpys(views: list[PhysicalRoom]) -> None:
    room = as_set(views)
    compiled, reference = (drawn(kind(room), "all", 6) for kind in (CpuRenderer, ReferenceRenderer))
    np.testing.assert_allclose(compiled, reference, atol=2e-5)  # float32 against float64, six steps


def test_a_pixel_that_another_view_sees_is_not_held_dark(views: list[PhysicalRoom]) -> None:
    """Each view's prior draws its unseen pixels to black. Together, only pixels that no view sees stay drawn."""
    held = []
    for number, view in enumerate(views):
        further = view.room.maps.refinement
        assert further is not None
        damping = np.zeros_like(further.step_size)
        # one row that only the other view sees, and one row that no view sees
        damping[number], damping[3] = 2.0, 1.0 + number
        lit = np.divide(1, further.step_size, out=np.zeros_like(damping), where=further.step_size > 0)
        lit[number] = lit[3] = 0
        total = lit + damping
        step = np.divide(1, total, out=np.zeros_like(total), where=total > 0)
        held.append((replace(further, prior=replace(further.prior, damping=damping), step_size=step), lit))
    maps = [replace(view.room.maps, refinement=one) for view, (one, _) in zip(views, held, strict=True)]
    for made, (before, lit) in zip(with_shared_darkness(maps), held, strict=True):
        after = made.refinement
        assert isinstance(after, RefinementMaps)
        assert not after.prior.damping[:2].any()
        np.testing.assert_array_equal(after.prior.damping[3], 1.0)
        expected = lit + after.prior.damping
        seen = expected > 0
        np.testing.assert_allclose(after.step_size[seen], 1 / expected[seen], rtol=1e-5)  # float32, converted twice
        assert not after.step_size[~seen].any()
        assert before.step_size.dtype == after.step_size.dtype


def test_radiance_of_one_view_is_refused(views: list[PhysicalRoom]) -> None:
    with pytest.raises(InputError, match="radiance of one view, the room has 2"):
        CpuRenderer(as_set(views)).open(radiance_frame(np.zeros((*CAMERA, 3), np.float32)).format)


def test_a_room_of_one_view_has_no_viewpoint(views: list[PhysicalRoom]) -> None:
    renderer = CpuRenderer(views[0].room)
    with pytest.raises(InputError, match="one has one; join views with: counterlight join VIEW"):
        renderer.adjust(Adjustments(viewpoint=((0, 0),)))


@pytest.mark.parametrize(
    ("said", "read"),
    [
        ("0.25", [[0.25, 0]]),
        ("-1,2.5", [[-1, 2.5]]),
        ("0 1,1", [[0, 0], [1, 1]]),
        (0.5, [[0.5, 0]]),
        ([0.5, 1], [[0.5, 1]]),
        ([[0.5, 1], [2]], [[0.5, 1], [2, 0]]),
        ("all", "all"),
    ],
)
def test_a_tracker_sets_the_viewpoint(said: object, read: object) -> None:
    stage = Stage()
    stage.advance(0.05)
    stage.commands.set("viewpoint", said)
    place = stage.commands.get("viewpoint")
    assert (place if read == "all" else [list(each) for each in place]) == read
    assert stage.screen.adjusted[-1].viewpoint == place


def test_a_tracker_sets_it_over_the_socket_sixty_times_a_second(tmp_path: Path) -> None:
    """Each request is answered, the last value counts, and no request reads or rebuilds the room."""
    stage, path = Stage(), tmp_path / "show.socket"
    stage.advance(0.05)
    server = ControlServer(path)
    try:
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(f"{path}")
            answers = b""
            for number in range(120):
                ask = {"command": ["set_property", "viewpoint", [number / 100, 0.5]], "request_id": number}
                client.sendall(json.dumps(ask).encode() + b"\n")
                server.poll(stage.commands)
                stage.advance(1 / 60)
                answers += client.recv(1 << 16)
    finally:
        server.close()
    errors = [json.loads(line)["error"] for line in answers.splitlines() if b"request_id" in line]
    assert errors == ["success"] * 120
    assert stage.commands.get("viewpoint") == ((1.19, 0.5),)
    assert [each.viewpoint for each in stage.screen.adjusted][-2:] == [((1.18, 0.5),), ((1.19, 0.5),)]
    assert len(stage.screen.shown) >= 120  # a frame is drawn at each step


@pytest.mark.parametrize("said", ["", "left", "1,2,3", "nan", None, True, [], [[1, 2, 3]], [[True]], "1e9", {"x": 1}])
def test_what_is_no_place_is_refused(said: object) -> None:
    stage = Stage()
    stage.advance(0.05)
    with pytest.raises(CommandError, match="viewpoint: expected all, X or X,Y, several with spaces between, found"):
        stage.commands.set("viewpoint", said)


def test_who_leaves_the_views_is_reported_once() -> None:
    stage = Stage()
    stage.outside = lambda viewpoint: "beyond" if viewpoint != "all" and viewpoint[0][0] > 1 else None
    stage.advance(0.05)
    for place in (0.5, 1.5, 1.6, 1.7, 0.5, 1.5):
        stage.commands.set("viewpoint", place)
    assert [line for line in stage.session.stats.latest_notices() if "beyond" in line] == ["beyond"] * 2
