"""The way that light took, from T alone, against scenes with known light: simulator settings and independent rays."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from counterlight.arrays import BoolArray
from counterlight.tools.joining.cameras import CameraOptions, joined_cameras
from counterlight.tools.joining.projectors import join_transports
from counterlight.tools.simulation.geometry import trace
from counterlight.tools.simulation.room import simulated_calibration
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.transport.transport import in_one, luminance, luminance_matrix
from counterlight.tools.ways.bending import LEAST_PX, Lines
from counterlight.tools.ways.ways import BENT, BLURRED, BOUNCED, SCATTERED, WAYS, Way, Ways, ways_of
from tests.camera_rooms import FIRST, LEFT, PROJECTOR, RIGHT, SECOND, beside, calibration_of, homography, transport_seen
from tests.scenes import SCENES, plane, scene_file, small


def ways_in(scene: Scene) -> Ways:
    result = simulate(scene)
    return ways_of(simulated_calibration(scene, result), result.transport)


def shown(ways: Ways, way: Way) -> BoolArray:
    return np.asarray(ways.first == 1 + WAYS.index(way))


def seen_surface(scene: Scene) -> np.ndarray:
    """Return the index of the surface that the middle of each camera pixel sees."""
    directions, _ = scene.camera.pixel_rays(range(scene.camera.height), 1)
    hit = trace(scene.camera.position, directions, scene.surfaces)
    return hit.surface.reshape(scene.camera.height, scene.camera.width)


def test_on_a_flat_wall_all_light_is_straight() -> None:
    ways = ways_in(small("wall"))
    assert ways.lit.all()
    assert (ways.first == 0).all()
    assert ways.shares.sum(axis=0).max() < 0.01
    assert ways.finest().max() == 4


@pytest.mark.parametrize("dense", [False, True])
def test_light_that_bounced_has_its_share(dense: bool) -> None:
    """The truth is the room without inter-reflection. T as a single matrix does not mark the far light."""
    scene = small("corner", (21, 36), (20, 32))
    result, without = simulate(scene), simulate(scene, without=["inter_reflection"])
    whole, straight = (luminance(each.transport.composition()).reshape(21, 36) for each in (result, without))
    truth = 1 - straight / whole
    T = replace(result.transport, near=in_one(result.transport), far=None) if dense else result.transport
    ways = ways_of(simulated_calibration(scene, result), T)
    found = ways.shares[WAYS.index(BOUNCED)]
    # In a dense T, light from the fold's other side surrounds the footprint and counts as straight.
    apart = np.abs(np.arange(36) - 16.5) > 4
    assert np.abs(found - truth)[:, apart].max() < (0.08 if dense else 1e-4)
    assert np.count_nonzero(shown(ways, BOUNCED) != (truth >= 0.1)) < (0.12 if dense else 1e-9) * truth.size


def test_wax_scatters_and_its_board_does_not() -> None:
    scene = small("skull", (48, 36), (64, 64))
    ways, wax = ways_in(scene), seen_surface(scene) == 1
    light = np.zeros_like(wax)
    light[1:-1, 1:-1] = True
    scattered = ways.flags[WAYS.index(SCATTERED)]
    assert scattered[wax & ways.lit].mean() > 0.85  # the remaining pixels are sockets, lit by the surrounding bone
    assert scattered[~wax & light].mean() < 0.03  # the others are pixels on the edge
    assert not shown(ways, BENT)[wax].mean() > 0.03


def test_milk_scatters_though_its_colours_go_equally_far(tmp_path: Path) -> None:
    """Milk has long tails in its footprints. A card out of focus has none."""
    milk = "albedo = [0.8, 0.8, 0.8]\ntranslucency = { mean_free_path = [0.03, 0.03, 0.03] }"
    scene = load_scene(scene_file(tmp_path, plane(extra=milk))).resized((24, 32), (32, 40))
    inner = (slice(4, -4), slice(4, -4))
    assert shown(ways_in(scene), SCATTERED)[inner].mean() > 0.9
    lens = scene_file(tmp_path, plane(), projector="aperture = 0.25\nfocus_distance = 1.5")
    blurred = ways_in(load_scene(lens).resized((24, 32), (32, 40)))
    assert shown(blurred, BLURRED)[inner].mean() > 0.9
    assert not shown(blurred, SCATTERED).any()


def test_only_the_card_out_of_focus_is_blurred(tmp_path: Path) -> None:
    text = (SCENES / "two_planes.toml").read_text().replace("aperture = 0.05", "aperture = 0.2")
    (tmp_path / "open.toml").write_text(text)
    scene = load_scene(tmp_path / "open.toml").resized((36, 48), (54, 72))
    ways, card = ways_in(scene), seen_surface(scene)
    blurred = shown(ways, BLURRED)
    assert blurred[(card == 1) & ways.lit].mean() > 0.9
    assert not blurred[card == 0].any()
    assert np.median(ways.finest()[(card == 1) & ways.lit]) > np.median(ways.finest()[(card == 0) & ways.lit])


def test_what_is_seen_or_lit_through_glass_is_bent() -> None:
    """The truth is the change that glass makes in T: each row against the row of the room without glass."""
    scene = small("glass", (40, 54), (40, 54))
    result, without = simulate(scene), simulate(replace(scene, surfaces=scene.surfaces[:1]))
    ways = ways_of(simulated_calibration(scene, result), result.transport)
    light, bare = (luminance_matrix(in_one(each.transport)) for each in (result, without))
    changed = (abs(light - bare).sum(axis=1) / bare.sum(axis=1)).reshape(40, 54)
    bent = shown(ways, BENT)
    assert bent[changed > 0.8].mean() > 0.65  # light bent along its line, or by a fifth of a pixel, is not detected
    assert bent[changed < 0.1].mean() < 0.03  # the others are next to an edge
    assert not any(shown(ways, way).mean() > 0.005 for way in WAYS if way is not BENT)


def test_two_projectors_and_two_cameras_on_a_wall_are_straight() -> None:
    """Each pair has its own lines. Each camera pixel has two footprints, one per projector picture."""
    rooms, transports = [], []
    for camera, H in ((FIRST, LEFT), (SECOND, RIGHT)):
        one, other = (transport_seen(camera, bent(H)) for bent in (homography, beside))
        room = calibration_of(one, "wall")
        rooms.append(replace(room, projectors=room.projectors * 2))
        transports.append(join_transports([one, other], [PROJECTOR] * 2))
    shared = joined_cameras(rooms, transports, "joint", CameraOptions())
    ways = ways_of(shared.calibration, shared.transport)
    counts = shared.calibration.mask
    assert counts.sum() > 1500
    assert (ways.first[counts] == 0).all()


def test_lines_are_those_of_the_two_places() -> None:
    """Points at random depths before two pinholes lie on their lines. Points moved across their lines are found."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:30, :40] + 0.5
    depth = rng.uniform(2, 4, x.shape)
    X, Y = (x - 20) / 40 * depth, (y - 15) / 40 * depth
    middle = np.stack([40 * (Y - 0.2) / (depth + 0.3) + 15, 40 * (X - 0.5) / (depth + 0.3) + 20], axis=2)
    lit, moved = np.ones(x.shape, bool), middle.copy()
    moved[10:16, 12:20, 0] += 5 * LEAST_PX
    lines = Lines(moved, lit)
    assert np.abs(lines.distance(middle)).max() < 1e-3  # exact up to rounding in the refinement
    bent = lines.bent(moved)
    assert bent[11:15, 13:19].all()
    bent[9:17, 11:21] = False
    assert not bent.any()
