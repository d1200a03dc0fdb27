"""relight: the four views against dense numpy, and the command as a user runs it."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import sparse

from counterlight import calibration
from counterlight.calibration import Calibration, StoredCalibration
from counterlight.files import exr
from counterlight.maps import room_maps as maps
from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import RowMap, unpack
from counterlight.pipeline.operators import compensation
from counterlight.tools import build_correction_map
from counterlight.tools.relight import SHOWN
from counterlight.tools.relighting.pictures import white_level
from counterlight.tools.transport.transport import Transport, channels, far_light_of
from tests.programs import fail, succeed
from tests.rooms import CAMERA, CELLS, PROJECTOR, random_map, random_room, write_blurred_room

ROOM_CAMERA, ROOM_PROJECTOR = (9, 14), (7, 12)


def dense(packed: RowMap) -> np.ndarray:
    """Return a row map as (3, output pixels, source pixels)."""
    rows = unpack(packed)
    shape = rows.indptr.size - 1, packed.source_shape[0] * packed.source_shape[1]
    weights = rows.weights.T.astype(float)
    return np.stack([sparse.csr_array((w, rows.indices, rows.indptr), shape=shape).toarray() for w in weights])


def dense_inverse(room: RoomMaps) -> np.ndarray:
    """Return T⁺ = S⁺ (I − U M' D') as (3, projector pixels, camera pixels)."""
    near = dense(room.correction)
    if room.undo is None:
        return near
    far = dense(room.undo.scatter) @ dense(room.undo.mix) @ dense(room.undo.gather)
    return near @ (np.eye(near.shape[2]) - far)


def times(matrix: np.ndarray, picture: np.ndarray) -> np.ndarray:
    return np.stack([matrix[i] @ picture[..., i].ravel() for i in range(3)], axis=1)


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> tuple[StoredCalibration, Transport]:
    """Write a small room with its correction map."""
    folder = tmp_path_factory.mktemp("relight") / "wall"
    transport = write_blurred_room(folder, np.random.default_rng(5), ROOM_CAMERA, ROOM_PROJECTOR)
    assert build_correction_map.main([str(folder), "--regularize", "0.05"]) == 0
    return calibration.read(folder), transport


def far_transport(rng: np.random.Generator) -> Transport:
    """Return near and far light of the sizes CAMERA, PROJECTOR and CELLS."""
    camera, projector, cells = (side[0] * side[1] for side in (CAMERA, PROJECTOR, CELLS))

    def part(*shape: int) -> tuple[sparse.csr_array, ...]:
        return tuple(sparse.csr_array(rng.uniform(size=shape) * (rng.uniform(size=shape) < 0.2)) for _ in range(3))

    far = far_light_of(part(cells, projector), rng.uniform(size=(3, cells, cells)), part(camera, cells))
    return Transport.from_matrices(part(camera, projector), far, camera=CAMERA, projector=PROJECTOR)


def room_of(rng: np.random.Generator) -> Calibration:
    return random_room(rng, far=False).calibration


def test_composition_and_dual_are_the_matrix_and_its_transpose(rng: np.random.Generator) -> None:
    transport, room = far_transport(rng), room_of(rng)
    assert transport.far is not None
    T = np.stack([near.toarray() for near in channels(transport.near)])
    U, D = (np.stack([m.toarray() for m in channels(part)]) for part in (transport.far.scatter, transport.far.gather))
    T = T + U @ transport.far.mix.matrices @ D
    p, c = rng.uniform(size=(*PROJECTOR, 3)), rng.uniform(size=(*CAMERA, 3))
    seen = transport @ p
    np.testing.assert_allclose(seen.reshape(-1, 3), times(T, p), rtol=1e-12)  # float64 sums of positive terms
    lit = transport.T @ c
    # the same tolerance as above
    np.testing.assert_allclose(lit.reshape(-1, 3), times(T.transpose(0, 2, 1), c), rtol=1e-12)
    assert np.sum(seen * c) == pytest.approx(np.sum(p * lit), rel=1e-12)  # ⟨Tp, c⟩ = ⟨p, Tᵀc⟩, float64
    floodlit = transport.floodlight(room.ambient)
    # the same tolerance as above
    np.testing.assert_allclose(floodlit, T.sum(axis=2).T.reshape(*CAMERA, 3) + room.ambient, rtol=1e-12)
    np.testing.assert_allclose(
        transport.T @ np.ones((*CAMERA, 3)).reshape(-1, 3), T.sum(axis=1).T, rtol=1e-12
    )  # the same tolerance as above


@pytest.mark.parametrize("far", [False, True])
def test_the_inverse_views_sum_the_players_inverse(rng: np.random.Generator, far: bool) -> None:
    room = random_room(rng, far=far).maps
    T_pinv, found = dense_inverse(room), compensation(room)
    white, full = np.ones((*CAMERA, 3)), np.ones((*PROJECTOR, 3))
    tolerance = {"rtol": 1e-9, "atol": 1e-9}  # float64 sums of some hundred terms around 1, with cancellation
    np.testing.assert_allclose(found.apply(white).reshape(-1, 3), T_pinv.sum(axis=2).T, **tolerance)
    np.testing.assert_allclose(found.apply_transpose(full).reshape(-1, 3), T_pinv.sum(axis=1).T, **tolerance)
    p, c = rng.uniform(size=(*PROJECTOR, 3)), rng.uniform(size=(*CAMERA, 3))
    forth, back = np.sum(found.apply(c) * p), np.sum(c * found.apply_transpose(p))
    assert forth == pytest.approx(back, rel=1e-9, abs=1e-9)  # the same tolerance as above


def test_the_white_level_is_positive_whatever_the_picture() -> None:
    assert white_level(np.arange(101.0)) == 99
    spark = np.zeros(1000)
    spark[0] = 7
    assert white_level(spark) == 7
    assert white_level(-np.ones(5)) == 1


def test_maps_with_far_light_are_random_enough(rng: np.random.Generator) -> None:
    """Far light changes the answer, so that the test of compensation with far light can fail."""
    room = random_room(rng, far=True).maps
    assert room.undo is not None
    white, plain = np.ones((*CAMERA, 3)), RoomMaps(room.correction, room.transport, None, None, room.white)
    assert np.abs(compensation(room).apply(white) - compensation(plain).apply(white)).max() > 0.1
    assert random_map(rng, CAMERA, PROJECTOR, 3).count > 0


@pytest.mark.parametrize("view", ["camera", "dual", "inverse-camera", "inverse-dual"])
def test_each_view_as_a_command(stored: tuple[StoredCalibration, Transport], tmp_path: Path, view: str) -> None:
    room, transport = stored
    room_maps = maps.read_maps(room)
    expected = {
        "camera": transport.composition() + room.calibration.ambient.reshape(-1, 3),
        "dual": transport.apply_transpose(np.ones((transport.shape[0], 3))),
        "inverse-camera": dense(room_maps.correction).sum(axis=1).T,
        "inverse-dual": dense(room_maps.correction).sum(axis=2).T,
    }[view]
    out = succeed("relight", room.folder, "--view", view, "-o", tmp_path / "view.exr")
    described, last = out.splitlines()
    assert described == f"{tmp_path / 'view.exr'}: {view}, {size_of(view)}, linear values"
    assert last.startswith(f"{tmp_path / 'view.exr'}: {SHOWN[view]}; next: counterlight ")
    found = exr.read_rgb(tmp_path / "view.exr").reshape(-1, 3)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)  # float32 files of values around 1
    assert "white is 0.5" in succeed("relight", room.folder, "--view", view, "--white", 0.5, "-o", tmp_path / "v.png")
    png = cv2.imread(str(tmp_path / "v.png"))
    linear = np.clip(expected / 0.5, 0, 1).reshape(png.shape)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(png[..., ::-1], 255 * srgb, atol=0.6)  # rounding, and interpolation in the table
    assert sorted(path.name for path in tmp_path.iterdir()) == ["v.png", "view.exr"]


def size_of(view: str) -> str:
    height, width = ROOM_CAMERA if view.endswith("camera") else ROOM_PROJECTOR
    return f"{width}x{height}"


def test_a_drive_is_relit_and_ambient_can_be_left_out(
    stored: tuple[StoredCalibration, Transport], tmp_path: Path, rng: np.random.Generator
) -> None:
    room, transport = stored
    drive = rng.uniform(size=(*ROOM_PROJECTOR, 3)).astype(np.float32)
    exr.write_rgb(tmp_path / "p.exr", drive)
    succeed("relight", room.folder, tmp_path / "p.exr", "--no-ambient", "-o", tmp_path / "c.exr")
    expected = transport.apply(drive.reshape(-1, 3).astype(float)).reshape(*ROOM_CAMERA, 3)
    np.testing.assert_allclose(exr.read_rgb(tmp_path / "c.exr"), expected, rtol=1e-6)  # a float32 file


def test_a_png_is_decoded_and_fitted(stored: tuple[StoredCalibration, Transport], tmp_path: Path) -> None:
    """A white PNG of another size but the same aspect gives the floodlit room."""
    room, transport = stored
    cv2.imwrite(str(tmp_path / "white.png"), np.full((35, 60, 3), 255, np.uint8))
    succeed("relight", room.folder, tmp_path / "white.png", "--no-ambient", "-o", tmp_path / "c.exr")
    found = exr.read_rgb(tmp_path / "c.exr").reshape(-1, 3)
    np.testing.assert_allclose(found, transport.composition(), rtol=1e-6)  # a float32 file


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "out.jpg"], "cannot write .jpg"),
        (["-o", "nowhere/out.png"], "no such folder"),
        (["--view", "dual", "--ambient", "-o", "out.png"], "--ambient"),
        (["--white", "0", "-o", "out.png"], "expected a level above 0"),
        (["missing.png", "-o", "out.png"], "missing.png"),
        (["bright.exr", "-o", "out.png"], "a projector shows 0 to 1"),
        (["small.exr", "-o", "out.png"], "an OpenEXR picture of 3x2 pixels, expected 12x7"),
    ],
)
def test_wrong_use_is_one_line_and_leaves_no_file(
    stored: tuple[StoredCalibration, Transport],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    exr.write_rgb(tmp_path / "bright.exr", np.full((*ROOM_PROJECTOR, 3), 1.5, np.float32))
    exr.write_rgb(tmp_path / "small.exr", np.full((2, 3, 3), 0.5, np.float32))
    assert message in fail("relight", stored[0].folder, *arguments)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bright.exr", "small.exr"]


def test_an_inverse_view_without_a_map_names_the_command(tmp_path: Path, rng: np.random.Generator) -> None:
    write_blurred_room(tmp_path / "wall", rng, ROOM_CAMERA, ROOM_PROJECTOR)
    line = fail("relight", tmp_path / "wall", "--view", "inverse-dual", "-o", tmp_path / "out.png")
    assert "build" in line
    assert not (tmp_path / "out.png").exists()
