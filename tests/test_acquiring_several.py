"""Acquires several projectors in one run: one black capture, one projector after the other, one room."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.files import exr
from counterlight.files.picture_files import read_picture
from counterlight.tools import acquire_transport, verify_projection
from counterlight.tools.acquisition.plan import REPEATS
from counterlight.tools.acquisition.ramps import light_level
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import channel
from tests.camera_rooms import write_pairs
from tests.joint_rooms import LEFT, OVERLAP, RIGHT, join, write_halves
from tests.programs import fail, here
from tests.rig.product import COVERED
from tests.test_acquisition import same_files, unfinished

FAINT = "--full-well", "1e6", "--exposures", "1"


@pytest.fixture(scope="module")
def truth(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two overlapping projectors of different sizes, responses and black levels; their light adds in the overlap."""
    folder = tmp_path_factory.mktemp("several")
    stored = calibration.read(join(write_halves(folder, right_response="linear"), folder / "joint"))
    ambient = stored.calibration.ambient.copy()
    ambient[:, : OVERLAP.stop] += 0.008
    ambient[:, OVERLAP.start :] += 0.012
    with calibration.writing(folder / "truth", replace(stored.calibration, ambient=ambient)) as stage:
        write_transport(read_transport(stored), stage)
    return folder / "truth"


@pytest.fixture(scope="module")
def acquired(truth: Path) -> Path:
    folder = truth.parent / "acquired"
    here("acquire", "--camera", f"simulated:{truth}", *FAINT, "-o", folder)
    return folder


def test_both_are_measured_in_one_run(truth: Path, acquired: Path) -> None:
    found, true = calibration.read(acquired), calibration.read(truth)
    room = found.calibration
    assert [device.shape for device in room.projectors] == [LEFT, RIGHT]
    codes = np.linspace(0, 1, 64)[:, None].repeat(3, axis=1)
    for device, meant in zip(room.projectors, true.calibration.projectors, strict=True):
        np.testing.assert_allclose(device.response.to_linear(codes), meant.response.to_linear(codes), atol=0.01)
    exact, measured = (channel(read_transport(stored).near, 1).toarray() for stored in (true, found))
    assert np.linalg.norm(measured - exact) < 0.05 * np.linalg.norm(exact)  # noise, and light below the threshold
    assert room.mask.mean() > 0.85  # without footprints that the border of a raster cuts
    np.testing.assert_allclose(room.ambient, true.calibration.ambient, atol=0.001)  # noise of the black captures


def test_what_they_share_is_captured_once(acquired: Path) -> None:
    """Black and two floodlights are captured once. Then each projector shows its pictures while the other is black."""
    captures = acquired.with_name("acquired.captures") / "captures"
    seen = [read_picture(captures / f"{number:05}.png").mean() for number in range(3 * REPEATS)]
    assert max(seen[0::3]) < 0.2 * min(seen[1::3] + seen[2::3])
    figures = json.loads((acquired.with_name("acquired.report") / "report.json").read_text())
    assert figures["pictures"] == len(list(captures.iterdir()))
    assert [each["width"] for each in figures["projectors"]] == [LEFT[1], RIGHT[1]]
    assert {"floodlight_1.png", "floodlight_2.png"} < {
        path.name for path in acquired.with_name("acquired.report").iterdir()
    }
    page = (acquired.with_name("acquired.report") / "index.html").read_text()
    assert "Projector 2: response" in page
    assert "projector 2: a random pattern: error of the prediction" in page


@pytest.mark.parametrize("left", [3 * REPEATS - 5, 3 * REPEATS + 2 * len(light_level(LEFT).patterns)])
def test_an_interrupted_one_goes_on_where_it_stopped(truth: Path, acquired: Path, tmp_path: Path, left: int) -> None:
    """The run is interrupted among the floodlights, and in the first projector's scheme."""
    whole, torn = acquired.with_name("acquired.captures"), tmp_path / "again.captures"
    shutil.copytree(whole, torn)
    unfinished(torn)
    for path in (torn / "captures").iterdir():
        if int(path.stem) >= left:
            path.unlink()
    words = "acquire", "--camera", f"simulated:{truth}", *FAINT, "--name", "acquired", "-o", tmp_path / "again"
    printed = here(*words)
    resumed = sum(map(int, re.findall(r"exposures, (\d+) of them from before", printed)))
    assert resumed == left
    same_files(tmp_path / "again", acquired)
    same_files(torn / "captures", whole / "captures")


def test_black_is_evened_out_by_what_was_measured(truth: Path, acquired: Path, tmp_path: Path) -> None:
    """The report gives a black level for the whole picture, at which the overlap is not brighter than the rest."""
    report = json.loads((acquired.with_name("acquired.report") / "report.json").read_text())
    line = next(line for line in report["summary"] if line.startswith("black: "))
    found = re.fullmatch(r"black: (\S+) to (\S+) % of white; counterlight play --black-level (\S+) shows it even", line)
    assert found is not None, line
    stored, mask = calibration.read(truth), calibration.read(acquired).calibration.mask
    inside, edge = slice(OVERLAP.start + 2, OVERLAP.stop - 2), 3  # columns of the overlap, and width of the edge
    here("build", acquired)
    cv2.imwrite(str(tmp_path / "black.png"), np.zeros((20, 40, 3), np.uint8))
    stripes = []
    for level in ("0", found[3]):
        drive = tmp_path / f"{level}.exr"
        words = "--black-level", level, "--refine", "8", "--backend", "cpu", "--output", drive
        here("play", acquired, tmp_path / "black.png", *words)
        light = read_transport(stored) @ exr.read_rgb(drive).astype(np.float64) + stored.calibration.ambient
        columns = np.ma.median(np.ma.array(light[..., 1], mask=~mask), axis=0)
        stripes.append(columns[inside].mean() - columns[edge : OVERLAP.start - 2].mean())
    assert stripes[0] > 0.011  # black in the overlap is 0.03, at the left 0.018
    assert abs(stripes[1]) < 0.001  # 8 steps leave this error at pixels of random albedo


def test_verify_projects_with_both(truth: Path, acquired: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert verify_projection.main([str(acquired), "--camera", f"simulated:{truth}", *FAINT]) == 0
    assert "nothing has changed" in capsys.readouterr().out
    assert verify_projection.main([str(acquired), "--camera", f"simulated:{truth.parent / 'left'}", *FAINT]) == 2
    line = capsys.readouterr().err
    assert "the projector has 44x30 pixels, " in line
    assert "is for 44x30 and 36x26; name each of them with --monitor or --projector, from the left" in line


def test_nine_of_ten_values_are_inside_the_interval_of_both(truth: Path, acquired: Path, tmp_path: Path) -> None:
    """Both projectors light the picture; the checks showed one projector at a time."""
    shape = calibration.read(truth).calibration.camera.shape
    picture = cv2.resize(np.random.default_rng(2).integers(30, 220, (6, 9, 3)).astype(np.uint8), shape[::-1])
    cv2.imwrite(str(tmp_path / "picture.png"), picture)
    printed = here(
        "verify", acquired, tmp_path / "picture.png", "--camera", f"simulated:{truth}", *FAINT, "--repeats", "1"
    )
    found = COVERED.search(printed)
    assert found, printed
    assert float(found["inside"]) == pytest.approx(90, abs=6)


def test_two_projectors_and_two_cameras_at_once(tmp_path: Path) -> None:
    """The acquired room equals the room that is joined from exact projectors, then cameras."""
    pairs = write_pairs(tmp_path, gain=(0.9, 1.0, 1.2))
    truth, found = tmp_path / "truth", tmp_path / "found"
    here("join", *pairs, "--cameras", "-o", truth)
    cameras = [part for pair in pairs for part in ("--camera", f"simulated:{pair}")]
    said = here("acquire", *cameras, *FAINT, "-o", found)
    assert "\nexpected on the wall: " in said
    assert re.search(r"camera 2: \d+ of its pixels see what is on the screen already; its light times 1\.1", said)
    exact, measured = (calibration.read(each) for each in (truth, found))
    room, expected = measured.calibration, exact.calibration
    assert (room.cameras, room.regions) == (expected.cameras, expected.regions)
    T, meant = (channel(read_transport(each).near, 1).toarray() for each in (measured, exact))
    assert np.linalg.norm(T - meant) < 0.05 * np.linalg.norm(meant)  # noise, and light below the threshold
    assert room.screen is not None
    assert expected.screen is not None
    both = room.mask & expected.mask
    away = (room.screen.positions - expected.screen.positions)[both]
    # in camera pixels: a fifth of a projector pixel
    assert np.percentile(np.abs(away - np.median(away, axis=0)), 95) < 0.3


def test_a_folder_is_shown_the_raster(tmp_path: Path) -> None:
    line = fail(
        "acquire", "--camera", f"folder:{tmp_path / 'exchange'}", "--projector", "8x6", "--projector", "5x4",
        "-o", tmp_path / "room",
    )  # fmt: skip
    assert "waiting for 64 captures" in line
    first, second = (read_picture(tmp_path / "exchange" / "patterns" / f"{number:05}.png") for number in (1, 2))
    assert first.shape == (6, 13)
    np.testing.assert_array_equal(first > 0, np.arange(13) < np.full((6, 1), 8))
    assert second[:4, 8:].min() == 255
    assert second[4:].max() == second[:, :8].max() == 0


def test_captures_of_other_projectors_are_not_mixed(
    truth: Path, acquired: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(acquired.with_name("acquired.captures"), tmp_path / "captures")
    unfinished(tmp_path / "captures")
    words = "--camera", f"simulated:{truth.parent / 'left'}", *FAINT, "--captures", tmp_path / "captures"
    assert acquire_transport.main([str(word) for word in (*words, "-o", tmp_path / "room")]) == 2
    assert "captures of another acquisition" in capsys.readouterr().err
