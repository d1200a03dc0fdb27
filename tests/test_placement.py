"""Placement: pinned by its corners, filtered, and stored next to the calibration."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.pipeline.placement import (
    FILE,
    corners_of,
    fit,
    homography,
    read_placement,
    share_outside,
    write_placement,
)
from tests.oracles import formulas
from tests.oracles.formulas import pinned
from tests.rooms import write_blurred_room


def test_upright_corners_place_a_picture_as_fitting_does(rng: np.random.Generator) -> None:
    for size in ((40, 31), (5, 4), (23, 60)):
        picture = rng.uniform(size=(*size, 3))
        target = (20, 33)
        spot = fit(size, 1.0, target)
        H = homography(corners_of(spot, target), target, size)
        expected = formulas.resample(picture, target, (spot.left, spot.top, spot.width, spot.height))
        np.testing.assert_allclose(pinned(picture, target, H), expected, atol=1e-9)


def test_the_share_of_a_picture_outside_the_light() -> None:
    lit = np.zeros((40, 60), bool)
    lit[:, 30:] = True
    for left, share in ((0.0, 0.5), (0.5, 0.0), (-1.0, 0.75), (-3.0, 0.875)):
        assert share_outside(((left, 0.0), (1.0, 0.0), (1.0, 1.0), (left, 1.0)), lit) == share


def test_corners_map_as_opencv_says(rng: np.random.Generator) -> None:
    """An enlarged ramp is reproduced exactly: each pixel shows its position in the picture."""
    corners, target, size = ((0.1, 0.15), (0.85, 0.05), (0.95, 0.9), (0.2, 0.8)), (60, 80), (9, 12)
    v, u = np.mgrid[: size[0], : size[1]] + 0.5
    shown = pinned(np.stack([u, v, np.ones_like(u)], axis=2), target, homography(corners, target, size))
    quad = np.array(corners, np.float32) * (target[1], target[0])
    H = cv2.getPerspectiveTransform(np.float32(quad), np.float32([[0, 0], [12, 0], [12, 9], [0, 9]]))
    y, x = np.mgrid[: target[0], : target[1]] + 0.5
    place = cv2.perspectiveTransform(np.stack([x, y], axis=2).astype(np.float64), H)
    inner = np.all((place > 1) & (place < np.array([11, 8])), axis=2)
    assert inner.sum() > 1000
    np.testing.assert_allclose(shown[inner, :2], place[inner], atol=1e-5)
    outside = np.any((place < -0.5) | (place > np.array([12.5, 9.5])), axis=2)
    assert shown[outside].max() == 0
    # The covered area is the quadrilateral's area, partly covered edges included.
    assert shown[..., 2].sum() == pytest.approx(cv2.contourArea(np.float32(quad)), rel=2e-3)


def test_a_mirrored_picture_is_mirrored(rng: np.random.Generator) -> None:
    picture, target = rng.uniform(size=(30, 40, 3)), (30, 40)
    upright = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    mirrored = (upright[1], upright[0], upright[3], upright[2])
    np.testing.assert_allclose(pinned(picture, target, homography(upright, target, (30, 40))), picture, atol=1e-12)
    np.testing.assert_allclose(
        pinned(picture, target, homography(mirrored, target, (30, 40))), picture[:, ::-1], atol=1e-12
    )


@pytest.mark.parametrize("angle", [0, 17, 45, 80])
def test_a_fine_pattern_made_small_becomes_its_mean(angle: int) -> None:
    """A target pixel covers seven single-pixel squares of a chequerboard. Sampling alone would give 0 and 1."""
    board = np.repeat((np.indices((300, 300)).sum(axis=0) % 2)[..., None], 3, axis=2).astype(float)
    turn = np.deg2rad(angle)
    radius = 300 / 7 / 100 / np.sqrt(2)
    corners = tuple(
        (0.5 + radius * np.cos(turn + k * np.pi / 2), 0.5 + radius * np.sin(turn + k * np.pi / 2)) for k in range(4)
    )
    shown = pinned(board, (100, 100), homography(corners, (100, 100), (300, 300)))[..., 0]  # type: ignore[arg-type]
    inner = np.hypot(*(np.mgrid[:100, :100] - 49.5)) < 300 / 7 / 2 - 2
    np.testing.assert_allclose(shown[inner], 0.5, atol=0.02)  # side lobes of the tent filter


def test_a_placement_is_kept_beside_the_calibration(tmp_path: Path) -> None:
    corners = ((0.1, 0.2), (0.9, 0.1), (1.05, 0.9), (-0.02, 0.8))
    assert read_placement(tmp_path) is None
    write_placement(tmp_path, corners)
    assert read_placement(tmp_path) == corners
    write_placement(tmp_path, None)
    assert read_placement(tmp_path) is None
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("format = 2", "format 2, this version reads 1"),
        ("format = 1", "needs corners"),
        ("format = 1\ncorners = [[0, 0], [1, 0], [1, 1]]", "a list of 4 lists of 2 numbers"),
        ('format = 1\ncorners = [[0, 0], [1, 0], [1, 1], ["a", 1]]', "2 numbers from -2 to 3"),
        ("format = 1\ncorners = [[0, 0], [1, 1], [1, 0], [0, 1]]", "they cross"),
        ("corners = [", "not valid TOML"),
    ],
)
def test_a_damaged_placement_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / FILE).write_text(text)
    with pytest.raises(InputError, match=message):
        read_placement(tmp_path)


def test_a_placement_does_not_disturb_a_calibration(tmp_path: Path, rng: np.random.Generator) -> None:
    write_blurred_room(tmp_path / "room", rng)
    fingerprint = calibration.read(tmp_path / "room").fingerprint
    write_placement(tmp_path / "room", ((0.1, 0.2), (0.9, 0.1), (1.0, 0.9), (0.0, 0.8)))
    assert calibration.read(tmp_path / "room").fingerprint == fingerprint
