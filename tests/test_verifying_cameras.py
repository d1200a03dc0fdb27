"""counterlight verify with several projectors and cameras: which device has changed, and which camera measures it."""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.pipeline.drift import read_drift
from counterlight.tools import verify_projection
from counterlight.tools.acquisition.room_check import changed_exposures
from tests.camera_rooms import write_pairs
from tests.drifted_rooms import write_changed
from tests.programs import here

Capture = pytest.CaptureFixture[str]
PIXEL = r"-?\d\.\d\d"


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two projectors that two cameras see. The second camera's light is 0.9, 1 and 1.2 times its light in T."""
    folder = tmp_path_factory.mktemp("pairs")
    here("join", *write_pairs(folder, gain=(0.9, 1.0, 1.2)), "--cameras", "-o", folder / "room")
    return folder / "room"


def verify(room: Path, *words: object) -> int:
    return verify_projection.main([str(word) for word in (room, *words)])


# Changed rooms: the message, and whether the calibration still holds.
CHANGES: dict[str, tuple[dict[str, Any], str, bool]] = {
    "nothing": ({}, "nothing has changed", True),
    "a picture": (
        {"shifts": [(0, 0), (0.8, -0.5)]},
        rf"projector 2's picture has moved by 0\.[78]\d, -0\.[45]\d pixels \(its corners by up to {PIXEL}\): corrected",
        True,
    ),
    "a lamp": (
        {"lamps": [0.85, 1.0]},
        r"projector 1's light is (8[45]\.\d%(, )?){3} of what it was: corrected",
        True,
    ),
    "an exposure": (
        {"exposures": [1.0, 0.8]},
        r"camera 2's exposure is ((80\.\d|79\.9)%(, )?){3} of what it was",
        True,
    ),
    "a camera": (
        {"cameras": [(0, 0), (1, 0)]},
        rf"camera 2 has moved by (1\.0|0\.9)\d, {PIXEL} of its pixels: put it back \(the others are used\)",
        True,
    ),
    "a camera and a picture": (
        {"cameras": [(0, 1), (0, 0)], "shifts": [(-0.7, 0.4), (0, 0)]},
        rf"camera 1 has moved by {PIXEL}, (1\.0|0\.[89])\d of its pixels: put it back \(the others are used\); "
        rf"projector 1's picture has moved by -0\.[67]\d, 0\.[34]\d pixels \(its corners by up to {PIXEL}\): corrected",
        True,
    ),
    "all cameras": (
        {"cameras": [(0, 1), (1, 0)]},
        rf"camera 1 has moved by {PIXEL}, {PIXEL} of its pixels: put it back; camera 2 has moved by {PIXEL}, {PIXEL} "
        r"of its pixels: put it back; what is calibrated no longer holds: acquire again",
        False,
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_who_has_changed_is_distinguished(room: Path, tmp_path: Path, capsys: Capture, change: str) -> None:
    how, said, holds = CHANGES[change]
    write_changed(tmp_path / "now", calibration.read(room), **how)
    code = verify(room, "--camera", f"simulated:{tmp_path / 'now'}", "--no-preflight")
    printed = capsys.readouterr().out
    assert re.fullmatch(rf"{said}; next: counterlight .*\n", printed), printed
    assert code == (0 if holds else verify_projection.LOST)


def test_one_camera_tells_whose_lamp_it_is(room: Path, tmp_path: Path, capsys: Capture) -> None:
    """A dimmer lamp makes an edge visible where one picture ends inside the other.

    The edge is not mistaken for camera movement.
    """
    pair = room.parent / "first pair"
    write_changed(tmp_path / "now", calibration.read(pair), lamps=[0.85, 1.0])
    assert verify(pair, "--camera", f"simulated:{tmp_path / 'now'}", "--no-preflight") == 0
    assert re.fullmatch(
        r"projector 1's light is (8[45]\.\d%(, )?){3} of what it was: corrected; next: counterlight .*\n",
        capsys.readouterr().out,
    )


def test_a_picture_is_measured_by_every_camera(room: Path, tmp_path: Path, capsys: Capture) -> None:
    cv2.imwrite(str(tmp_path / "picture.png"), np.full((30, 40, 3), 140, np.uint8))
    words = tmp_path / "picture.png", "--rounds", "1", "--no-correct", "-o", tmp_path / "seen"
    assert verify(room, *words, "--camera", f"simulated:{room}") == 0
    said = capsys.readouterr().out
    assert len(re.findall(r"\n  camera [12]: predicted \S+ dB, measured \S+ dB; ", said)) == 4
    assert "the picture arrives as predicted" in said
    write_changed(tmp_path / "now", calibration.read(room), cameras=[(0, 0), (1, 0)], exposures=[0.9, 1.0])
    assert verify(room, *words[:-1], tmp_path / "turned", "--camera", f"simulated:{tmp_path / 'now'}") == 0
    said = capsys.readouterr().out
    assert "camera 2: " not in said  # the camera sees another place
    assert "the picture arrives as predicted" in said


def test_a_correction_is_for_all_cameras(room: Path, tmp_path: Path) -> None:
    """Ambient light changes in the room. Each camera's ambient light is stored in the units of T."""
    stored = calibration.read(room)
    write_changed(tmp_path / "now", stored, ambient=3.0)
    assert verify(room, "--camera", f"simulated:{tmp_path / 'now'}", "--no-preflight") == 0
    drift = read_drift(stored)
    assert drift is not None
    assert drift.ambient is not None
    for view in stored.calibration.views:
        expected = 3 * stored.calibration.ambient[view].mean(axis=(0, 1))
        np.testing.assert_allclose(
            drift.ambient[view].mean(axis=(0, 1)), expected, rtol=0.02
        )  # noise of a dark picture


def test_what_matched_a_camera_is_kept_with_it(room: Path, tmp_path: Path) -> None:
    """The gains stay, in any order and number of joins. A calibration without a gain has 1."""
    gains = calibration.read(room).calibration.gains
    np.testing.assert_allclose(gains, [[1, 1, 1], [1 / 0.9, 1, 1 / 1.2]], rtol=0.01)  # median of the pixels' own ratios
    here("join", room, room.parent / "second pair", "--cameras", "-o", tmp_path / "three")
    found = calibration.read(tmp_path / "three").calibration.gains
    np.testing.assert_allclose(found, [*gains, gains[1]], rtol=0.01)
    manifest = (tmp_path / "three" / "calibration.toml").read_text()
    assert len(re.findall(r"^gain = \[$", manifest, re.MULTILINE)) == 3
    bare = re.sub(r"^gain = \[\n(.*\n)*?\]\n", "", manifest, flags=re.MULTILINE)
    (tmp_path / "three" / "calibration.toml").write_text(bare)
    np.testing.assert_array_equal(calibration.read(tmp_path / "three").calibration.gains, np.ones((3, 3)))
    wrong = re.sub(r"^gain = \[\n.*\n", "gain = [\n    0.0,\n", manifest, flags=re.MULTILINE)
    (tmp_path / "three" / "calibration.toml").write_text(wrong)
    with pytest.raises(InputError, match="expected 3 numbers from 1e-06 to 1e"):
        calibration.read(tmp_path / "three")


def test_other_cameras_are_refused(room: Path, tmp_path: Path, capsys: Capture) -> None:
    first = room.parent / "first pair"
    assert verify(room, "--camera", f"simulated:{first}", "--no-preflight") == 2
    line = capsys.readouterr().err
    assert (
        "the cameras give 50x36, the calibration was made with 50x36 and 44x32: name each of them with --camera" in line
    )


@pytest.mark.parametrize(
    ("projectors", "cameras"),
    [
        ([1], [1, 1]),
        ([0.9], [1, 1]),
        ([1], [1, 0.8]),
        ([1, 0.9], [1, 1]),
        ([0.9, 1], [1, 1, 1.3]),
        ([0.9, 0.8], [1, 1]),
    ],
)
def test_a_change_is_the_one_of_fewest(projectors: list[float], cameras: list[float]) -> None:
    gains = np.multiply.outer(projectors, cameras)[..., None].repeat(3, axis=2)
    found = changed_exposures(gains)
    np.testing.assert_allclose(found, np.repeat(np.array(cameras)[:, None], 3, axis=1), rtol=1e-6)


def test_cameras_that_share_no_projector_are_not_distinguished() -> None:
    gains = np.full((2, 2, 3), np.nan)
    gains[0, 0], gains[1, 1] = 0.9, 1.0
    np.testing.assert_array_equal(changed_exposures(gains), 1.0)
    chain = np.full((2, 3, 3), np.nan)  # a wall: the middle camera sees both
    chain[0, :2], chain[1, 1:] = [[1.0], [0.8]], [[0.8], [1.0]]
    np.testing.assert_allclose(changed_exposures(chain)[:, 0], [1, 0.8, 1], rtol=1e-6)
