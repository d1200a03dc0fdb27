"""Sets of views: joined, read, refused, simulated, and from a scene to a picture."""

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.pipeline.views_together import check_views
from counterlight.tools.joining.cameras import CameraOptions
from counterlight.tools.joining.views import join_views, on_shared_screen
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import Transport
from counterlight.viewpoints import Places, read_places
from tests.camera_rooms import FIRST, LEFT, calibration_of, homography, transport_seen
from tests.programs import fail, succeed
from tests.scenes import SCENES

LINE = Places(((0.5, 1), (-0.5, 0), (0, 0.5)))
LINE2 = Places(((0, 0), (1, 0)))


def shifted(by: float) -> np.ndarray:
    """Return a homography to the wall, in projector pixels, of a camera that looks `by` pixels further to the right."""
    return LEFT + np.outer([1, 0, 0], [0, 0, by])


def seen_view(shift: float, gain: float = 1.0) -> tuple[Calibration, Transport]:
    """Return the calibration and T of a flat wall, for a camera shifted to the right."""
    transport = transport_seen(FIRST, homography(shifted(shift)), (gain, gain, gain))
    return calibration_of(transport, f"at {shift}"), transport


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder, made = tmp_path_factory.mktemp("views"), []
    for number, (shift, gain) in enumerate(((0, 1.0), (2, 0.8))):
        room, transport = seen_view(shift, gain)
        made.append(folder / f"{number}")
        with calibration.writing(made[-1], room) as stage:
            write_transport(transport, stage)
    return made


@pytest.fixture(scope="module")
def joined(folders: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("set") / "room"
    said = join_views(folders, Places(((-1, 0), (1, 0))), output, CameraOptions())
    assert said.splitlines()[0] == f"{output}: 2 views of 50x36, screen 53x36"
    assert "view 2: " in said
    assert "its light times 1.249 1.250 1.251" in said
    return output


def test_views_share_a_screen_and_stay_calibrations_of_their_own(folders: list[Path], joined: Path) -> None:
    """Both views show a wall place at the same screen position. The second camera looks 2 projector pixels further."""
    rooms = [calibration.read(joined / "views" / name) for name in "12"]
    first, second = (room.calibration.screen for room in rooms)
    assert first is not None
    assert second is not None
    assert first.shape == second.shape
    x, y = homography(np.linalg.inv(LEFT))(*homography(shifted(2))(*_centres()))
    offset = first.positions.reshape(-1, 2) - np.stack(_centres(), axis=1)
    found, counts = second.positions.reshape(-1, 2) - offset, rooms[1].calibration.mask.ravel()
    away = np.linalg.norm(found - np.stack([x, y], axis=1), axis=1)[counts]
    assert np.median(away) < 0.05  # in pixels: error of the centres of footprints
    assert np.percentile(away, 99) < 0.5
    alone = read_transport(calibration.read(folders[1]))
    together = read_transport(rooms[1])
    ratio = together.composition()[counts] / alone.composition()[counts]
    np.testing.assert_allclose(ratio, 1.25, rtol=5e-3)  # matched by medians over pixels
    assert read_places(joined, calibration.TOML) == Places(((-1, 0), (1, 0)))


def _centres() -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[: FIRST[0], : FIRST[1]].reshape(2, -1) + 0.5
    return x, y


def test_a_view_that_was_calibrated_anew_is_refused(joined: Path, folders: list[Path], tmp_path: Path) -> None:
    room = tmp_path / "room"
    shutil.copytree(joined, room)
    shutil.rmtree(room / "views" / "2")
    with pytest.raises(InputError, match=r"views/2: no calibration, .*viewpoints.toml lists 2; join the views again"):
        read_places(room, calibration.TOML)
    shutil.copytree(folders[1], room / "views" / "2")
    with pytest.raises(InputError, match="views/2: another calibration than that which"):
        read_places(room, calibration.TOML)


def test_a_set_is_no_calibration_and_a_view_is(joined: Path) -> None:
    with pytest.raises(InputError, match=r"a set of views, expected one calibration; name a view, as .*views/1$"):
        calibration.read(joined)
    with pytest.raises(InputError, match="is a set of views already"):
        join_views([joined, joined], LINE2, joined.parent / "again", CameraOptions())


def test_a_set_is_replaced_only_by_force(folders: list[Path], tmp_path: Path) -> None:
    output = tmp_path / "room"
    for force in (False, True):
        join_views(folders, LINE2, output, CameraOptions(), force=force)
    with pytest.raises(InputError, match="a calibration is there already"):
        join_views(folders, LINE2, output, CameraOptions())
    (output / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes.txt: is no part of a calibration"):
        join_views(folders, LINE2, output, CameraOptions(), force=True)


def test_what_does_not_fit_together_is_refused(folders: list[Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="2 calibrations, 3 places; give --at"):
        join_views(folders, LINE, tmp_path / "room", CameraOptions())
    with pytest.raises(InputError, match="views 1 and 3 are both at 0,1; leave one out"):
        Places(((0, 1), (0, 0), (0, 1)))
    with pytest.raises(InputError, match="65 views, expected 1 to 64"):
        Places(tuple((float(x), 0.0) for x in range(65)))
    room, transport = seen_view(0)
    narrower = replace(room, camera=replace(room.camera, width=49))
    with pytest.raises(InputError, match="gallery: view 2 has a camera of 49x36, view 1 of 50x36"):
        check_views([room, narrower], "gallery")
    pair = replace(room, projectors=room.projectors * 2)
    with pytest.raises(InputError, match=r"gallery: view 2 has projectors of 48x27 \+ 48x27, view 1 of 48x27"):
        check_views([room, pair], "gallery")
    views, _ = on_shared_screen([room, seen_view(1)[0]], [transport, seen_view(1)[1]], "gallery", CameraOptions())
    with pytest.raises(InputError, match="view 1 is of 1 cameras; a view has one"):
        on_shared_screen([views[0][0]], [transport], "gallery", CameraOptions())


@pytest.mark.parametrize(
    ("added", "line"),
    [
        ("at = [[0, 0], [0, 0]]", r"views 1 and 2 are both at 0,0"),
        ("at = [[0, 0, 1]]", r"at.*: .*2 numbers"),
        ("at = 3", r"a list of 1 lists of 2 numbers"),
        ("at = [[0, 0]]\nto = 3", r"to"),
    ],
)
def test_a_scene_s_viewpoints_are_checked(added: str, line: str, tmp_path: Path) -> None:
    (tmp_path / "room.toml").write_text((SCENES / "wall.toml").read_text() + f"\n[viewpoints]\n{added}\n")
    with pytest.raises(InputError, match=line):
        load_scene(tmp_path / "room.toml")


def test_a_scene_s_camera_stands_at_each_viewpoint_and_looks_at_one_point(tmp_path: Path) -> None:
    text = (SCENES / "wall.toml").read_text()
    (tmp_path / "room.toml").write_text(text + "\n[viewpoints]\nat = [[0, 0], [0.3, 0], [0, -0.4]]\n")
    scene, before = load_scene(tmp_path / "room.toml"), load_scene(SCENES / "wall.toml")
    cameras = [view.camera for view in scene.views]
    np.testing.assert_allclose(cameras[0].position, before.camera.position)
    for camera, (right, up) in zip(cameras, ((0, 0), (0.3, 0), (0, -0.4)), strict=True):
        expected = before.camera.position + right * before.camera.right + up * before.camera.up
        np.testing.assert_allclose(camera.position, expected)
        x, y, depth = camera.project(np.zeros((1, 3)))  # the point that wall.toml looks at
        np.testing.assert_allclose([x[0], y[0]], [camera.width / 2, camera.height / 2], atol=1e-9)
        np.testing.assert_allclose(depth, np.linalg.norm(camera.position))
        axes = np.stack([camera.right, camera.up, camera.forward])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


def test_from_a_scene_to_a_picture_between_views(tmp_path: Path) -> None:
    """Whole commands: a set is simulated, built and played from an intermediate viewpoint.

    Three viewpoints give three pictures.
    """
    (tmp_path / "room.toml").write_text(
        (SCENES / "wall.toml").read_text() + "\n[viewpoints]\nat = [[-0.3, 0], [0.3, 0]]\n"
    )
    sizes = "--camera", "48x32", "--projector", "32x20"
    said = succeed("simulate", tmp_path / "room.toml", *sizes, "-o", tmp_path / "set")
    assert f"{tmp_path / 'set'}: 2 views of 48x32, screen " in said
    assert "view 2 of 2" in succeed("build", tmp_path / "set", "--inverse", "none")
    cv2.imwrite(f"{tmp_path / 'grey.png'}", np.full((32, 48, 3), 120, np.uint8))
    shown = []
    for place in ("-0.3", "0", "0.3"):
        output = tmp_path / f"{len(shown)}.png"
        succeed("play", tmp_path / "set", tmp_path / "grey.png", f"--viewpoint={place}", "--output", output)
        shown.append(cv2.imread(f"{output}").astype(float))
    lit = np.minimum(shown[0], shown[2]) > 0
    between = np.abs(shown[1] - (shown[0] + shown[2]) / 2)[lit]
    assert np.median(between) < 2  # in code values: a matt wall looks the same from both sides
    assert "expected X or X,Y, found '1,2,3'" in fail("join", tmp_path, "--at", "1,2,3", "-o", tmp_path / "other")
