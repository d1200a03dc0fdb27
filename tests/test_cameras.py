"""Several cameras: their rows in one raster, the screen that they share, their light, and the weight of each pixel."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from counterlight import calibration
from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.screen import FILE, Screen
from counterlight.tools.joining.cameras import CameraOptions, joined_cameras, same_projectors
from counterlight.tools.joining.shared_screen import SharedRoom
from counterlight.tools.simulation.room import simulated_room
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.solve.box import Box
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import Dense, FarLight, Transport, channel, stacked
from counterlight.tools.transport.trust import shares
from tests.camera_rooms import (
    FIRST,
    LEFT,
    PROJECTOR,
    RIGHT,
    SECOND,
    SPREAD,
    Map,
    calibration_of,
    folded,
    homography,
    looks_at,
    position_in_first,
    transport_seen,
)
from tests.scenes import SCENES

RoomSeen = tuple[Calibration, Transport]


def room_seen(camera: tuple[int, int], where: Map, name: str = "room") -> RoomSeen:
    transport = transport_seen(camera, where)
    return calibration_of(transport, name), transport


def shared(*rooms: RoomSeen, **options: object) -> SharedRoom:
    calibrations, transports = zip(*rooms, strict=True)
    return joined_cameras(calibrations, transports, "joint", CameraOptions(**options))  # type: ignore[arg-type]


def screen_of(found: SharedRoom) -> Screen:
    assert found.calibration.screen is not None
    return found.calibration.screen


@pytest.fixture(scope="module")
def flat() -> list[RoomSeen]:
    """Two cameras of a flat wall, each of which sees only part of the lit area."""
    return [room_seen(FIRST, homography(LEFT), "first"), room_seen(SECOND, homography(RIGHT), "second")]


def away(found: Screen, camera: int, expected: np.ndarray) -> np.ndarray:
    """Distance between a camera's positions on the screen and the expected positions, in pixels.

    The first camera's view is the screen, up to an offset.
    """
    own = np.moveaxis(np.mgrid[: FIRST[0], : FIRST[1]][::-1], 0, -1) + 0.5
    shift = (found.positions[found.parts[0]] - own).reshape(-1, 2)
    np.testing.assert_allclose(shift - shift[0], 0, atol=1e-4)  # float32 of up to a hundred pixels
    return np.asarray(np.linalg.norm(found.positions[found.parts[camera]] - shift[0] - expected, axis=2))


def test_rows_stand_below_each_other(flat: list[RoomSeen], rng: np.random.Generator) -> None:
    """Thesis eq. 4.7 with two cameras of different width, one with far light."""
    cells = 3
    gather, scatter = rng.uniform(size=(cells, flat[0][1].shape[1])), rng.uniform(size=(flat[0][1].shape[0], cells))
    far = FarLight(
        stacked([sparse.csr_array(gather)] * 3),
        Dense(rng.uniform(0, 1e-3, (3, cells, cells))),
        stacked([sparse.csr_array(scatter)] * 3),
    )
    rooms = [(flat[0][0], replace(flat[0][1], far=far)), flat[1]]
    found = shared(*rooms, keep_exposures=True)
    assert found.calibration.camera.shape == (FIRST[0] + SECOND[0], max(FIRST[1], SECOND[1]))
    p = rng.uniform(size=(*PROJECTOR, 3))
    seen = found.transport @ p
    for view, (room, transport) in zip(found.calibration.views, rooms, strict=True):
        np.testing.assert_allclose(seen[view], transport @ p, rtol=1e-6)  # both results use the same float32 entries
        np.testing.assert_array_equal(found.calibration.mask[view], room.mask)
        np.testing.assert_array_equal(found.calibration.ambient[view], room.ambient)
    beside = np.ones(seen.shape[:2], bool)
    for view in found.calibration.views:
        beside[view] = False
    assert beside.any()
    assert not seen[beside].any()
    assert not found.calibration.mask[beside].any()


def test_a_flat_wall_is_one_screen_also_where_only_one_camera_sees_it(flat: list[RoomSeen]) -> None:
    """Maps between pictures of a plane are projective, and the map is continued beyond the overlap."""
    found, expected = shared(*flat), position_in_first(SECOND, RIGHT)
    error, counts = away(screen_of(found), 1, expected), flat[1][0].mask
    overlap, beyond = counts & (expected[..., 0] < FIRST[1] - 3), counts & (expected[..., 0] > FIRST[1])
    assert min(overlap.sum(), beyond.sum()) > 200
    # Centres of footprints err by hundredths of a pixel; 441 of them fit a map of 8 numbers, extended by half a view.
    assert np.percentile(error[overlap], 99) < 0.1
    assert error[beyond].max() < 0.3
    assert found.placed[1].tied > 300


def test_a_fold_is_followed(flat: list[RoomSeen]) -> None:
    """The wall has a fold where both cameras look, and the smooth map keeps it."""
    bent = [room_seen(FIRST, folded(LEFT)), room_seen(SECOND, folded(RIGHT))]
    expected = position_in_first(SECOND, RIGHT)  # both cameras see the fold's line at the same projector pixels
    error = away(screen_of(shared(*bent)), 1, expected)
    overlap = bent[1][0].mask & (expected[..., 0] < FIRST[1] - 3)
    assert overlap.sum() > 200
    assert np.percentile(error[overlap], 95) < 0.15  # in pixels


def test_reflections_do_not_move_the_screen(flat: list[RoomSeen], rng: np.random.Generator) -> None:
    """A tenth of the second camera's pixels see another part of the wall, as behind glass."""
    second, T = flat[1]
    lost = rng.random(T.shape[0]) < 0.1
    rows = np.where(lost, rng.permutation(T.shape[0]), np.arange(T.shape[0]))
    found, expected = shared(flat[0], (second, replace(T.at(rows), camera=SECOND))), position_in_first(SECOND, RIGHT)
    overlap = second.mask & (expected[..., 0] < FIRST[1] - 3)
    assert (
        np.percentile(away(screen_of(found), 1, expected)[overlap], 99) < 0.3
    )  # the wrong pixels are off by 14 pixels on average


def test_the_screen_of_a_projector_needs_no_overlap() -> None:
    """Two cameras with no common projector pixels share the projector picture as their screen."""
    apart = LEFT.copy(), RIGHT.copy()
    apart[0][0, 2], apart[1][0, 2] = -10, 30
    rooms = [room_seen(FIRST, homography(apart[0])), room_seen(SECOND, homography(apart[1]))]
    with pytest.raises(InputError, match=r"camera 2: \d+ pixels see projector pixels that the others see, expected"):
        shared(*rooms)
    screen = screen_of(shared(*rooms, screen="projector"))
    offsets = []
    for (room, _), part, H in zip(rooms, screen.parts, apart, strict=True):
        y, x = np.mgrid[: room.camera.height, : room.camera.width].reshape(2, -1) + 0.5
        looks = np.stack(homography(H)(x, y), axis=1)
        # only footprints that lie wholly inside
        whole = (np.minimum(looks, np.array(PROJECTOR[::-1]) - looks) > 3 * SPREAD).all(axis=1)
        error = screen.positions[part].reshape(-1, 2)[whole] - looks[whole]
        offsets.append(np.median(error, axis=0))
        assert np.abs(error - offsets[-1]).max() < 0.1  # in projector pixels
    np.testing.assert_allclose(*offsets, atol=0.02)


def test_light_is_matched_where_views_overlap(flat: list[RoomSeen]) -> None:
    gains = np.array([0.8, 1.0, 1.3])
    second = transport_seen(SECOND, homography(RIGHT), tuple(gains))  # type: ignore[arg-type]
    room = replace(calibration_of(second, "bright"), ambient=flat[1][0].ambient * gains.astype(np.float32))
    found, kept = shared(flat[0], (room, second)), shared(flat[0], (room, second), keep_exposures=True)
    np.testing.assert_allclose(found.placed[1].gain, 1 / gains, rtol=0.005)  # paint varies within a camera pixel
    np.testing.assert_array_equal(kept.placed[1].gain, 1)
    view, light = found.calibration.views[1], found.transport.composition().reshape(*found.calibration.camera.shape, 3)
    np.testing.assert_allclose(light[view], flat[1][1].composition().reshape(*SECOND, 3), rtol=0.006, atol=1e-9)
    np.testing.assert_allclose(found.calibration.ambient[view], flat[1][0].ambient, rtol=0.006)


def test_a_camera_beside_its_copy_counts_once(flat: list[RoomSeen]) -> None:
    """Each pixel counts half, so that the minimum equals the single camera's, up to rounding and the solver's gap."""
    room, T = flat[0]
    alone, twice = objective_of(T, room, DEFAULT_AIMS), shared(flat[0], flat[0])
    both = objective_of(twice.transport, twice.calibration, DEFAULT_AIMS)
    say = shares(twice.transport.near, twice.calibration).reshape(2, -1)
    # the copy's positions are off by hundredths of a pixel
    np.testing.assert_allclose(say[:, room.mask.ravel()], 0.5, atol=0.03)
    b = np.repeat(0.5 * room.mask.reshape(-1, 1), 3, axis=1)
    drives = [Box(each).solve(np.concatenate([b] * count)).drive for each, count in ((alone, 1), (both, 2))]
    seen = [T.apply(drive) for drive in drives]
    assert np.abs(seen[0] - seen[1])[room.mask.ravel()].max() < 0.5 * 1 / 255  # half a code, and the gap of the solver


def test_shares_add_up_to_the_screens_area(flat: list[RoomSeen]) -> None:
    """For fully seen projector pixels, several cameras together count as much as a single camera elsewhere."""
    found = shared(*flat)
    say = shares(found.transport.near, found.calibration)
    assert say.max() <= 1
    counts = found.calibration.mask.ravel()
    light = channel(found.transport.near, 1)
    rows = sparse.diags_array(np.where(counts, say / np.maximum(light.sum(axis=1), 1e-9), 0))
    total = np.asarray((rows @ light).sum(axis=0)).reshape(PROJECTOR)[6:-6]
    # The first camera's pixels have one size on the screen; perspective makes projector pixels differ by a third.
    smooth = np.median(total, axis=0)
    inner = smooth[8:40]
    assert np.abs(np.diff(inner)).max() < 0.08 * inner.max()  # no step at the end of a view


def test_three_cameras_follow_each_other(flat: list[RoomSeen]) -> None:
    """The third camera overlaps only the second, not the first; it is placed through the second in any order."""
    middle = RIGHT.copy()
    middle[0, 2] = 8
    far = RIGHT.copy()
    far[0, 2] = 24
    narrow = LEFT.copy()
    narrow[0] *= 0.5
    rooms = [
        room_seen(FIRST, homography(narrow)),
        room_seen(SECOND, homography(far)),
        room_seen(SECOND, homography(middle)),
    ]
    found = shared(*rooms)
    assert [each.number for each in found.placed] == [1, 3, 2]
    assert len(found.calibration.cameras) == 3


def test_what_is_written_is_read(tmp_path: Path, flat: list[RoomSeen]) -> None:
    found = shared(*flat)
    with calibration.writing(tmp_path / "room", found.calibration) as stage:
        write_transport(found.transport, stage)
    stored = calibration.read(tmp_path / "room")
    screen, expected = stored.calibration.screen, screen_of(found)
    assert screen is not None
    assert (screen.shape, screen.cameras) == (expected.shape, expected.cameras)
    np.testing.assert_array_equal(screen.positions, expected.positions)
    assert read_transport(stored).camera == stored.calibration.camera.shape
    text = (tmp_path / "room" / "calibration.toml").read_text()
    height = f"height = {SECOND[0]}"
    for old, new, complaint in (
        (height, "height = 9", f"{FILE}: 50x68, the cameras' raster is 50x45"),
        ("[screen]\nwidth = ", "[screen]\nwidth = 9999", "width: found"),
        ("[screen]", "[curtain]", "needs screen"),
        (height, "height = 1", "expected 2 to 16384|is 50x37"),
    ):
        assert old in text
        (tmp_path / "room" / "calibration.toml").write_text(text.replace(old, new))
        with pytest.raises(InputError, match=complaint):
            calibration.read(tmp_path / "room")


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e9])
def test_positions_are_numbers(flat: list[RoomSeen], value: float) -> None:
    screen = screen_of(shared(*flat))
    positions = screen.positions.copy()
    positions[FIRST[0] + 3, 5, 1] = value
    with pytest.raises(InputError, match="camera 2 looks where there is no number"):
        Screen(screen.shape, screen.cameras, positions)


def test_a_third_camera_sees_no_seam(tmp_path: Path) -> None:
    """A camera in between, unknown to the optimum for grey, sees grey.

    The means of its sRGB codes stay within one code of grey, per column at both ends of the cameras' overlap, and over
    the areas that one or both cameras see.
    """
    path, size = SCENES / "folded_wall.toml", ((72, 96), (36, 64))
    wall = re.sub("pattern = .*", "albedo = [0.7, 0.72, 0.74]", path.read_text())  # paint has edges of its own
    (tmp_path / "wall.toml").write_text(wall)
    scene = load_scene(tmp_path / "wall.toml").resized(*size)
    room, transport = simulated_room(scene, [simulate(view) for view in scene.views])
    text = wall.replace("position = [-0.8, 0.05, 2.6]\nlook_at = [-0.3, 0.0", "position = [0, 0, 2.7]\nlook_at = [0, 0")
    (tmp_path / "between.toml").write_text(text)
    audience = load_scene(tmp_path / "between.toml").resized(*size).views[0]
    white, grey = 0.45, 0.3
    b = np.full((room.camera.pixels, 3), white * grey) - room.ambient.reshape(-1, 3)
    drive = Box(objective_of(transport, room, DEFAULT_AIMS)).solve(b).drive
    result = simulate(audience)
    seen = (result.transport.apply(drive) + result.ambient.reshape(-1, 3)).reshape(72, 96, 3)
    codes = srgb(seen / white) - srgb(np.array(grey))
    inside = [_inside(looks_at(audience, view), view) for view in scene.views]
    plain = np.abs(codes).max(axis=2) < 20  # without pixels at the raster's edge and pixels that no camera sees
    for counted in (inside[0] & ~inside[1], inside[0] & inside[1], inside[1] & ~inside[0]):
        assert counted.sum() > 300
        assert np.abs(codes[counted & plain].mean(axis=0)).max() < 1
    both = (inside[0] & inside[1])[36]
    for end in (np.flatnonzero(both)[0], np.flatnonzero(both)[-1]):
        columns = np.array([codes[20:52, x][plain[20:52, x]].mean() for x in range(end - 4, end + 5)])
        assert np.abs(columns).max() < 1


def srgb(light: np.ndarray) -> np.ndarray:
    """Code values of light."""
    grid = np.linspace(0, 1, 4096)
    return np.interp(light, Response("srgb").to_linear(grid), 255 * grid)


def _inside(points: np.ndarray, scene: Scene) -> np.ndarray:
    return np.asarray(((points > 1) & (points < (scene.camera.width - 1, scene.camera.height - 1))).all(axis=-1))


@pytest.mark.parametrize(
    ("names", "cameras_differ", "same"),
    [
        ((None, None), True, True),
        ((None, None), False, False),
        (("HDMI-1", "HDMI-1"), False, True),
        (("HDMI-1", "DP-2"), True, False),
        (("HDMI-1", None), True, True),
    ],
)
def test_the_same_projector_is_recognised_by_its_monitor_or_the_cameras_sizes(
    tmp_path: Path, flat: list[RoomSeen], names: tuple[str | None, str | None], cameras_differ: bool, same: bool
) -> None:
    folders = []
    for number, (room, name) in enumerate(zip((flat[0], flat[int(cameras_differ)]), names, strict=True)):
        folders.append(tmp_path / f"{number}")
        projectors = tuple(replace(projector, monitor=name) for projector in room[0].projectors)
        with calibration.writing(folders[-1], replace(room[0], projectors=projectors)) as stage:
            write_transport(room[1], stage)
    assert same_projectors(folders) == same
