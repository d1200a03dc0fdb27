"""Drift stored with a calibration: its effect on a drive, and refusals of its file."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from counterlight import calibration
from counterlight.calibration import StoredCalibration
from counterlight.errors import InputError
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.drift import (
    FILE,
    FOLDER,
    LEAST_SHARE,
    Drift,
    Moved,
    read_drift,
    resampled,
    sampled,
    write_drift,
)
from counterlight.pipeline.room import read_room
from counterlight.raster import Region
from counterlight.tools import build_correction_map
from tests.drifted_rooms import moved_by
from tests.rooms import random_room, write_blurred_room, yuv_frame

REGIONS = Region(0, 0, 13, 7), Region(13, 0, 11, 5)


@pytest.fixture
def room(tmp_path: Path, rng: np.random.Generator) -> StoredCalibration:
    write_blurred_room(tmp_path / "room", rng, (11, 17), (7, 13))
    return calibration.read(tmp_path / "room")


def test_what_is_kept_is_read_again(room: StoredCalibration, rng: np.random.Generator) -> None:
    assert read_drift(room) is None
    found = Moved(np.array([[1.01, 0.02, 0.8], [0, 0.99, 0.6], [1e-4, 0, 1]]), np.array([0.9, 0.91, 0.89]))
    ambient = rng.uniform(0, 0.1, room.calibration.ambient.shape).astype(np.float32)
    share = rng.uniform(LEAST_SHARE, 1, ambient.shape[:2]).astype(np.float32)
    whole = Drift((found,), ambient, "moved", "2026-01-01", share)
    for kept in (whole, Drift((Moved.nothing(),), None, "nothing")):
        write_drift(room, kept)
        again = read_drift(room)
        assert again is not None
        np.testing.assert_array_equal(again.projectors[0].to_raster, kept.projectors[0].to_raster)
        np.testing.assert_array_equal(again.projectors[0].gain, kept.projectors[0].gain)
        assert (again.said, again.date, again.changes) == (kept.said, kept.date, kept.changes)
        for kept_light, light in ((kept.ambient, again.ambient), (kept.share, again.share)):
            assert light is None if kept_light is None else np.array_equal(light, kept_light)


HOSTILE = {
    "nan": (r"to_raster = .*?\n\]", "to_raster = [[nan, 0, 0], [0, 1, 0], [0, 0, 1]]", "expected 3 numbers"),
    "mirror": (r"to_raster = .*?\n\]", "to_raster = [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]", "turns the picture over"),
    "behind": (r"to_raster = .*?\n\]", "to_raster = [[1, 0, 0], [0, 1, 0], [-1, 0, 1]]", "turns the picture over"),
    "far": (r"to_raster = .*?\n\]", "to_raster = [[1, 0, 900], [0, 1, 0], [0, 0, 1]]", "have moved by 900 pixels"),
    "size": (r"size = .*?\n\]", "size = [12, 7]", "expected [13, 7], the calibrated projector's"),
    "dark": (r"gain = .*?\n\]", "gain = [0, 1, 1]", "expected 3 numbers from 0.05 to 20"),
    "other": (r'calibration = "', 'calibration = "0', "found for another state"),
    "format": (r"format = 1", "format = 2", "this version reads 1"),
    "two": (
        r"\[\[projectors\]\]",
        "[[projectors]]\nsize = [13, 7]\n[[projectors]]",
        "2 projectors, the calibration has 1",
    ),
    "none": (r"(?s)\A.*\Z", "", "found None, expected"),
    "no text": (r"(?s)\A.*\Z", "\x00", "not valid TOML"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_file_is_refused_in_one_line(room: StoredCalibration, case: str) -> None:
    write_drift(room, Drift((moved_by(0.8, 0.6),)))
    path = room.folder / FOLDER / FILE
    pattern, hostile, complaint = HOSTILE[case]
    if case == "none":
        complaint = "format"
    text, count = re.subn(pattern, lambda _: hostile, path.read_text(), count=1, flags=re.DOTALL)
    assert count == 1
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(complaint)) as refused:
        read_drift(room)
    assert "\n" not in str(refused.value)
    assert "counterlight verify" in str(refused.value)


def test_an_ambient_picture_that_differs_from_the_recorded_one_is_refused(room: StoredCalibration) -> None:
    write_drift(room, Drift((Moved.nothing(),), room.calibration.ambient))
    path = room.folder / FOLDER / "ambient.exr"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match="damaged or was replaced"):
        read_drift(room)


@pytest.mark.parametrize(("light", "says"), [(0.0, "shares from 0 to 1"), (2.0, "to 2"), (np.nan, "nan")])
def test_shares_that_are_none_are_refused(room: StoredCalibration, light: float, says: str) -> None:
    share = np.ones(room.calibration.camera.shape, np.float32)
    share[3, 4] = light
    write_drift(room, Drift((moved_by(0.8, 0.6),), share=share))
    with pytest.raises(InputError, match=says) as refused:
        read_drift(room)
    assert "counterlight verify" in str(refused.value)


def test_a_whole_pixel_is_moved_exactly_and_each_projector_within_its_own_picture(rng: np.random.Generator) -> None:
    drive = rng.uniform(0, 1, (7, 24, 3))
    shown = Drift((moved_by(2, -1), Moved.nothing())).shown(drive, REGIONS)
    expected = np.zeros_like(drive)
    expected[1:, :11] = drive[:-1, 2:13]
    expected[1:, 11], expected[1:, 12] = drive[:-1, 11], 0.75 * drive[:-1, 10]  # outside: a fading mirror image
    expected[0, :13] = np.array([1] * 12 + [0.75])[:, None] * drive[1, [*range(2, 13), 11, 10]]
    expected[:5, 13:] = drive[:5, 13:]  # nothing is shown below the second projector, which is lower
    np.testing.assert_allclose(shown, expected, atol=1e-6)  # the table is float32


def test_beyond_the_border_it_goes_on_for_a_pixel_and_fades_over_two_and_what_lands_there_is_lost() -> None:
    shown = Drift((moved_by(3.75, 0), moved_by(0, 0))).shown(np.ones((7, 24, 3)), REGIONS)
    np.testing.assert_allclose(shown[3, 8:13, 0], [1, 1, 0.875, 0.375, 0], atol=1e-6)
    np.testing.assert_allclose(resampled(np.ones((7, 13, 3)), moved_by(0.25, 0).to_raster)[3, 11:, 0], [1, 0.75])


def test_between_pixels_cubics_are_exact_and_beyond_the_border_is_a_mirror() -> None:
    x = np.arange(9.0)
    cubic = np.repeat((x**3 - 9 * x**2 + x)[None, :, None], 3, axis=0)
    at = np.array([[2.9, 1.2], [4.0, 1.5], [5.75, 1.0]])
    middle = at[:, 0] - 0.5
    np.testing.assert_allclose(sampled(cubic, at)[:, 0], middle**3 - 9 * middle**2 + middle, rtol=1e-12)
    np.testing.assert_allclose(sampled(cubic, np.array([[-0.5, 1.5]]))[0, 0], cubic[0, 1, 0], rtol=1e-12)


def test_light_that_clips_is_full_drive_and_a_dimmed_lamp_is_asked_for_more() -> None:
    drive = np.full((7, 24, 3), 0.6)
    shown = Drift((moved_by(0, 0, 0.8), moved_by(0, 0, 0.5))).shown(drive, REGIONS)
    np.testing.assert_allclose(shown[:5, [0, 20], 0], [[0.75, 1]] * 5, rtol=1e-6)


def test_what_is_shown_arrives_as_it_was_meant() -> None:
    """Waves of 24 pixels. Interpolation is exact for parabolas, so the error is of order (2π/24)³, twice."""
    N = np.array([[1.004, 0.01, 0.4], [-0.008, 0.997, 0.7], [1e-5, -2e-5, 1]])
    drift = Drift((Moved(N, np.array([0.9, 0.95, 1.0])),))
    region = (Region(0, 0, 96, 72),)
    y, x = np.mgrid[:72, :96]
    meant = np.repeat((0.4 + 0.3 * np.sin(2 * np.pi * (x + y / 2) / 24))[..., None], 3, axis=2)
    arrived = drift.landed(drift.shown(meant, region), region)
    assert np.abs(arrived - meant)[4:-4, 4:-4].max() < 3e-3
    assert np.abs(resampled(meant, np.eye(3)) - meant).max() < 1e-12


def test_identity_changes_no_bit_of_what_is_shown(rng: np.random.Generator) -> None:
    """A drift without changes needs no additional pass."""
    plain, frame = random_room(rng, far=False), yuv_frame(rng, (9, 15))
    room = replace(plain, drift=Drift((Moved.nothing(),), None, "nothing has changed"))
    shown = []
    for each in (plain, room):
        renderer = CpuRenderer(each)
        renderer.open(frame.format)
        renderer.upload(frame)
        renderer.render("projector", compensate=True)
        shown.append((renderer.encoded(), renderer.linear()))
        assert renderer._moved is None
    for before, after in zip(*shown, strict=True):
        np.testing.assert_array_equal(before, after)


def test_only_the_compensated_picture_is_moved(rng: np.random.Generator) -> None:
    plain, frame = random_room(rng, far=False), yuv_frame(rng, (9, 15))
    renderers = [CpuRenderer(each) for each in (plain, replace(plain, drift=Drift((moved_by(1, 0),))))]
    for renderer in renderers:
        renderer.open(frame.format)
        renderer.upload(frame)
    for view, compensate, same in (("projector", True, False), ("projector", False, True), ("camera", True, True)):
        for renderer in renderers:
            renderer.render(view, compensate=compensate)
        before, after = (renderer.linear() for renderer in renderers)
        assert np.array_equal(before, after) == same
        if not same:
            np.testing.assert_allclose(after[:, :-1], before[:, 1:], atol=1e-6)  # rounding to float32


def test_a_room_is_read_with_its_drift_and_maps_that_are_built_again_keep_it(room: StoredCalibration) -> None:
    assert build_correction_map.main([str(room.folder)]) == 0
    before = read_room(room.folder, None)
    now = (2 * room.calibration.ambient + 0.01).astype(np.float32)
    write_drift(room, Drift((moved_by(0.5, 0, 0.9),), now))
    assert build_correction_map.main([str(room.folder)]) == 0
    after = read_room(room.folder, None)
    assert before.drift is None
    assert after.drift is not None
    assert after.drift.moves
    np.testing.assert_array_equal(after.calibration.ambient, now)
    # the white that most of the room can reach falls with the lamp
    assert after.white == pytest.approx(0.9 * before.white)
    assert read_room(room.folder, 0.3).white == 0.3
