"""Commands with several cameras: join, simulate, acquire, build and play; commands for a single camera refuse them."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

import counterlight as cl
from counterlight import calibration
from counterlight.calibration import Device
from counterlight.files import exr
from counterlight.pipeline.room import read_room
from counterlight.raster import Region
from counterlight.response import Response
from counterlight.show.room_in_use import RoomInUse
from counterlight.tools import join_projectors
from counterlight.tools.relighting.pictures import read_placed
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import Transport, channels
from tests.camera_rooms import FIRST, PROJECTOR, SECOND, folded, write_views
from tests.programs import fail, succeed

RASTER = (FIRST[0] + SECOND[0], FIRST[1])
STEPS = 8


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_views(tmp_path_factory.mktemp("views"), gain=(0.9, 1.0, 1.2), bend=folded)


@pytest.fixture(scope="module")
def built(views: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Join both cameras; their sizes show that the projector is the same."""
    room = tmp_path_factory.mktemp("joint") / "room"
    said = succeed("join", *views, "-o", room)
    assert said.startswith("taken for several cameras of the same projectors\n")
    assert re.search(r"room: 2 cameras, raster 50x68, screen \d+x\d+\n", said)
    assert re.search(
        r"camera 2: \d+ of its pixels see what is on the screen already; its light times 1\.1\d+ 1\.00\d* 0\.8\d+ ",
        said,
    )
    succeed("build", room)
    return room


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("picture") / "picture.png"
    small = np.random.default_rng(3).uniform(30, 220, (14, 24, 3))
    cv2.imwrite(str(path), cv2.resize(small, (240, 140), interpolation=cv2.INTER_CUBIC).clip(0, 255).astype(np.uint8))
    return path


def below_optimum(text: str, solver: str) -> float:
    line = next(line for line in text.splitlines() if line.startswith(solver))
    return float(line.split()[7])


def test_the_player_is_near_the_joint_optimum(built: Path, picture: Path, tmp_path: Path) -> None:
    """Eight steps from T⁺ come within 0.3 dB of the box optimum of all rows, with either backend."""
    room, transport = calibration.read(built).calibration, read_transport(calibration.read(built))
    wanted = read_placed(picture, RASTER, room.screen) * 0.45
    solution = cl.solve(cl.read_room(built), wanted / 0.45, white=0.45)
    optimum = _psnr(solution.seen - wanted, room.mask)
    for backend in ("cpu", "gl"):
        drive = tmp_path / f"{backend}.exr"
        options = (
            "--backend",
            backend,
            "--white",
            "0.45",
            "--refine-from",
            "map",
            "--refine",
            str(STEPS),
            "--output",
            drive,
        )
        succeed("play", built, picture, *options)
        seen = transport @ exr.read_rgb(drive).astype(np.float64) + room.ambient
        assert _psnr(seen - wanted, room.mask) > optimum - 0.3


def _psnr(error: np.ndarray, mask: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((error[mask] / 0.45) ** 2)))


def test_cameras_see_one_picture_below_each_other(built: Path, picture: Path, tmp_path: Path) -> None:
    """The camera view is the raster: one part per camera, and black next to the narrower camera."""
    succeed("play", built, picture, "--white", "0.45", "--view", "camera", "--output", tmp_path / "seen.png")
    seen = cv2.imread(str(tmp_path / "seen.png"))
    assert seen is not None
    assert seen.shape[:2] == RASTER
    assert seen[FIRST[0] :, SECOND[1] :].max() == 0
    assert min(seen[: FIRST[0]].mean(), seen[FIRST[0] :, : SECOND[1]].mean()) > 40


def test_corners_place_on_the_screen(built: Path, picture: Path, tmp_path: Path) -> None:
    """The second camera sees a picture in the screen's right half, and the first hardly sees it."""
    (built / "placement.toml").write_text("format = 1\ncorners = [[0.75, 0.2], [1.0, 0.2], [1.0, 0.8], [0.75, 0.8]]\n")
    try:
        succeed("play", built, picture, "--white", "0.45", "--view", "camera", "--output", tmp_path / "right.exr")
    finally:
        (built / "placement.toml").unlink()
    seen, mask = exr.read_rgb(tmp_path / "right.exr"), calibration.read(built).calibration.mask
    first, second = (seen[part][mask[part]].mean() for part in calibration.read(built).calibration.views)
    assert second > 3 * first


def test_solvers_views_and_python_know_the_screen(built: Path, picture: Path, tmp_path: Path) -> None:
    said = succeed("compensate", built, picture, "--solver", "map,direct,box", "--white", "0.45")
    assert 0 < below_optimum(said, "map") < below_optimum(said, "direct")
    assert "50x68" in succeed("relight", built, picture, "--view", "camera", "-o", tmp_path / "lit.png")
    assert "48x27" in succeed("relight", built, picture, "--view", "dual", "-o", tmp_path / "dual.png")
    room = cl.read_room(built)
    np.testing.assert_array_equal(cl.read_picture(picture, room), read_placed(picture, RASTER, room.calibration.screen))
    radiance = np.full((*RASTER, 3), 0.2, np.float32)
    exr.write_rgb(tmp_path / "radiance.exr", radiance)
    succeed("play", built, tmp_path / "radiance.exr", "--output", tmp_path / "drive.exr")
    exr.write_rgb(tmp_path / "small.exr", radiance[: FIRST[0]])
    assert "the camera has 50x68" in fail("play", built, tmp_path / "small.exr", "--output", tmp_path / "drive.exr")


def test_placing_by_hand_is_on_the_screen(built: Path) -> None:
    """A point of the projector picture and the camera pixel that it lights give the same place on the screen."""
    room = read_room(built, None)
    in_use = RoomInUse(built, room, lambda: room, lambda fresh: pytest.fail("a renderer was made"))
    screen = room.calibration.screen
    assert screen is not None
    assert in_use.placed_on == screen.shape
    corners = ((0.3, 0.3), (0.6, 0.3), (0.6, 0.7), (0.3, 0.7))
    seen, lit = (in_use.outline(corners, 0, view) for view in ("camera", "projector"))
    # within a camera pixel
    np.testing.assert_allclose(in_use.pointed_at(seen.handles, "camera")[0], corners[0], atol=0.03)
    # a projector pixel
    np.testing.assert_allclose(in_use.pointed_at(lit.handles, "projector")[0], corners[0], atol=0.06)


def test_what_cannot_be_joined_as_cameras(views: list[Path], built: Path, tmp_path: Path) -> None:
    output = "-o", tmp_path / "room"
    assert "1 calibration to join" in fail("join", views[0], "--cameras", *output)
    assert "50x68" not in (line := fail("join", built, built, *output))
    assert "has several cameras; join the projectors that each camera saw" in line
    other = calibration.read(views[1]).calibration
    for name, projector, complaint in (
        ("size", Device(PROJECTOR[0], PROJECTOR[1] + 1, Response("srgb")), "projectors of 49x27, "),
        ("response", Device(*PROJECTOR, Response("linear")), "projector 1 has a response "),
    ):
        folder = tmp_path / name
        changed = calibration.Calibration(name, "", (projector,), other.camera, other.ambient, other.mask)
        with calibration.writing(folder, changed) as stage:
            T = read_transport(calibration.read(views[1]))
            write_transport(T if name == "response" else _wider(T), stage)
        assert complaint in fail("join", views[0], folder, "--cameras", *output)
    assert not (tmp_path / "room").exists()


def _wider(T: Transport) -> Transport:
    wide = [each.copy() for each in channels(T.near)]
    for each in wide:
        each.resize(each.shape[0], PROJECTOR[0] * (PROJECTOR[1] + 1))
    return Transport.from_matrices(wide)


def test_projectors_and_cameras_are_joined_in_turn(views: list[Path], tmp_path: Path) -> None:
    """Two equal projectors, seen by each camera, are joined first, then the cameras: several of both in one room."""
    pairs = []
    for view in views:
        succeed("join", view, view, "-o", tmp_path / f"{view.name} pair")
        pairs.append(tmp_path / f"{view.name} pair")
    succeed("join", *pairs, "--cameras", "-o", tmp_path / "all")
    room = calibration.read(tmp_path / "all").calibration
    assert room.cameras == (FIRST, SECOND)
    assert room.regions == (Region(0, 0, 48, 27), Region(48, 0, 48, 27))
    succeed("join", *views, "-o", tmp_path / "two")
    three = succeed("join", tmp_path / "two", views[0], "--cameras", "--name", "three", "-o", tmp_path / "three")
    assert "3 cameras" in three
    assert calibration.read(tmp_path / "three").calibration.cameras == (FIRST, SECOND, FIRST)


def test_a_raster_beyond_memory_is_refused_with_the_figure(
    views: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("counterlight.tools.joining.shared_screen.PIXEL_BYTES", 2.0**40)
    assert join_projectors.main([*map(str, views), "--cameras", "-o", str(tmp_path / "room")]) == 2
    line = capsys.readouterr().err
    assert "placing 2 cameras that see projectors of 48x27 together needs about 4808704.0 GiB of memory, " in line
    assert not (tmp_path / "room").exists()


def test_options_of_cameras_are_not_for_projectors(views: list[Path], tmp_path: Path) -> None:
    line = fail("join", views[0], views[0], "--keep-exposures", "-o", tmp_path / "room")
    assert "--screen and --keep-exposures are for cameras: add --cameras" in line


def test_cameras_photograph_every_pattern_together(views: list[Path], built: Path, tmp_path: Path) -> None:
    """A joint acquisition of both cameras gives one room on one screen, like joining two calibrations."""
    cameras = [part for view in views for part in ("--camera", f"simulated:{view}")]
    said = succeed("acquire", *cameras, "--scheme", "graycode", "--seed", "7", "-o", tmp_path / "room")
    assert re.search(r"camera 2: \d+ of its pixels see what is on the screen already; its light times 1\.1", said)
    found, expected = (calibration.read(each).calibration for each in (tmp_path / "room", built))
    assert found.cameras == expected.cameras
    assert found.screen is not None
    assert expected.screen is not None
    both = found.mask & expected.mask
    away = (found.screen.positions - expected.screen.positions)[both]
    away -= np.median(away, axis=0)
    assert np.percentile(np.abs(away), 95) < 1.0  # Gray codes give the projector pixel, which is 1.5 camera pixels wide
    for line, camera in (("cannot photograph together", "folder:exchange"), ("expected simulated:", "webcam")):
        assert line in fail("acquire", *cameras, "--camera", camera, "-o", tmp_path / "other")


def test_scenes_of_several_cameras(tmp_path: Path) -> None:
    """A small version of the shipped scene equals the join of both cameras, with their own exposures."""
    sizes = "--camera", "48x36", "--projector", "32x18"
    assert "2 cameras, raster 48x72" in succeed("simulate", "folded_wall", *sizes, "-o", tmp_path / "room")
    room = cl.simulate("folded_wall", camera=(36, 48), projector=(18, 32))
    stored = calibration.read(tmp_path / "room")
    assert stored.calibration.cameras == ((36, 48), (36, 48)) == room.calibration.cameras
    assert stored.calibration.provenance == "simulated from the scene folded_wall by counterlight simulate"
    np.testing.assert_allclose(
        read_transport(stored).composition(), room.parts.composition(), rtol=1e-5
    )  # the stored factors are float32
