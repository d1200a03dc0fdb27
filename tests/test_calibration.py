"""The calibration folder: it is read as it was written, and damage is refused with the fix."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.response import Response, parse_response

LINEAR = Response("linear")


@pytest.fixture
def room(rng: np.random.Generator) -> Calibration:
    ambient = rng.uniform(0, 0.1, (9, 13, 3)).astype(np.float32)
    mask = rng.uniform(size=(9, 13)) > 0.2
    projector = Device(7, 11, parse_response(2.2))
    return Calibration("room", "made by a test", (projector,), Device(9, 13, LINEAR), ambient, mask)


@pytest.fixture
def folder(tmp_path: Path, room: Calibration) -> Path:
    with calibration.writing(tmp_path / "room", room) as stage:
        (stage / "transport_red.npz").write_bytes(b"matrix")
    return tmp_path / "room"


def test_round_trip(folder: Path, room: Calibration) -> None:
    stored = calibration.read(folder)
    assert stored.calibration.name == room.name
    assert stored.calibration.projectors == room.projectors
    assert stored.calibration.camera == room.camera
    np.testing.assert_array_equal(stored.calibration.ambient, room.ambient)
    np.testing.assert_array_equal(stored.calibration.mask, room.mask)
    with stored.opened("transport_red.npz") as file:
        assert file.read() == b"matrix"


def test_the_curve_of_the_camera_is_kept(tmp_path: Path, room: Calibration) -> None:
    curve = Response("table", table=((0.0,), (0.2,), (1.0,)))
    with calibration.writing(tmp_path / "room", replace(room, camera=Device(9, 13, curve))):
        pass
    assert calibration.read(tmp_path / "room").calibration.camera == Device(9, 13, curve)


def test_floodlights_of_the_primaries_are_kept(tmp_path: Path, room: Calibration, rng: np.random.Generator) -> None:
    light = rng.uniform(0, 1, (3, 9, 13, 3)).astype(np.float32)
    with calibration.writing(tmp_path / "room", replace(room, primaries=light)):
        pass
    found = calibration.read(tmp_path / "room").calibration.primaries
    assert found is not None
    np.testing.assert_array_equal(found, light)
    (tmp_path / "room" / "primary_green.exr").unlink()
    with pytest.raises(InputError, match="primary_green"):
        calibration.read(tmp_path / "room")


def test_nothing_is_left_when_writing_fails(tmp_path: Path, room: Calibration) -> None:
    with pytest.raises(RuntimeError, match="stop"), calibration.writing(tmp_path / "room", room):
        raise RuntimeError("stop")
    assert list(tmp_path.iterdir()) == []


def test_a_calibration_is_replaced_only_when_asked(folder: Path, room: Calibration) -> None:
    before = calibration.read(folder).fingerprint
    with pytest.raises(InputError, match="--force"), calibration.writing(folder, room):
        pass
    assert calibration.read(folder).fingerprint == before
    with calibration.writing(folder, room, force=True):
        pass
    assert calibration.read(folder).fingerprint != before
    assert [path.name for path in folder.parent.iterdir()] == ["room"]


def test_another_folder_is_never_replaced(tmp_path: Path, room: Calibration) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.txt").write_text("mine")
    with (
        pytest.raises(InputError, match="no calibration folder"),
        calibration.writing(tmp_path / "thesis", room, force=True),
    ):
        pass
    assert (tmp_path / "thesis" / "chapter.txt").read_text() == "mine"


@pytest.mark.parametrize("name", ["ambient.exr", "mask.png"])
@pytest.mark.parametrize("damage", ["truncated", "flipped", "missing"])
def test_damaged_files_are_refused(folder: Path, name: str, damage: str) -> None:
    path = folder / name
    contents = bytearray(path.read_bytes())
    if damage == "missing":
        path.unlink()
    else:
        contents[len(contents) // 2] ^= 1
        path.write_bytes(contents if damage == "flipped" else contents[:-1])
    with pytest.raises(InputError, match=f"{name}.*make the calibration again"):
        calibration.read(folder)


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("format = 1", "format = 2", "format 2, this version reads 1"),
        ("format = 1", "format = 1 oops", "not valid TOML"),
        ("[camera]", "[kamera]", r"needs camera; is 'kamera' meant to be it"),
        ("width = 13", "width = 14", "the camera is 14x9"),
        ("width = 13", 'width = "13"', "expected a whole number from 1 to 16384"),
        ("width = 13", "width = 99999", "expected a whole number from 1 to 16384"),
        ("response = 2.2", 'response = "rec2100"', "expected linear, srgb"),
    ],
)
def test_a_wrong_table_is_refused(folder: Path, old: str, new: str, complaint: str) -> None:
    text = (folder / "calibration.toml").read_text()
    assert old in text
    (folder / "calibration.toml").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=complaint):
        calibration.read(folder)


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "red.npz").touch()
    with pytest.raises(InputError, match=r"matrices without calibration\.toml; .* counterlight import-transport"):
        calibration.read(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        calibration.read(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"an empty folder, expected a calibration folder"):
        calibration.read(tmp_path / "empty")


def test_a_mask_picture_is_black_and_white_at_the_middle(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "m.png"), np.array([[0, 127, 128, 255]], np.uint8))
    mask = calibration.read_mask_picture(tmp_path / "m.png", Device(1, 4, LINEAR))
    np.testing.assert_array_equal(mask, [[False, False, True, True]])
    with pytest.raises(InputError, match="4x1, the camera is 5x1"):
        calibration.read_mask_picture(tmp_path / "m.png", Device(1, 5, LINEAR))


HOSTILE = Path(__file__).resolve().parents[1].parent / "shared" / "data" / "hostile"


@pytest.mark.parametrize("name", ["ambient.exr", "mask.png", "calibration.toml"])
def test_hostile_files_in_a_calibration_are_refused(folder: Path, name: str) -> None:
    """Checksums stop hostile files before any decoder opens them, in the place of every file of the folder."""
    for path in [file for file in HOSTILE.rglob("*") if file.is_file()] or [Path(__file__)]:
        (folder / name).write_bytes(path.read_bytes())
        with pytest.raises(InputError, match="make the calibration again"):
            calibration.read(folder)
