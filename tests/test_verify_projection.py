"""counterlight verify: the closed loop in a simulated room, an acquisition's report, and changed rooms."""

import io
import json
import re
import shutil
import signal
from contextlib import redirect_stdout
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.files import exr
from counterlight.pipeline.drift import read_drift
from counterlight.processing import LEVELS, Processing
from counterlight.response import Response
from counterlight.tools import acquire_transport, verify_projection
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, simulated_rooms
from counterlight.tools.acquisition.preflight import CHECKS
from counterlight.tools.acquisition.room_check import REPEATS
from counterlight.tools.inverse.pictures import typical_pictures
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.transport.interval import CELL, Interval, write_interval
from counterlight.tools.transport.storage import read_transport, write_transport
from tests.drifted_rooms import write_changed
from tests.joint_rooms import join, write_halves
from tests.programs import PATIENCE_S, running, verb
from tests.rig.product import COVERED
from tests.rooms import write_blurred_room
from tests.test_acquisition import CAMERA, PROJECTOR


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with room/ (the truth), acquired/ (acquired with few noisy captures) and picture.png."""
    folder = tmp_path_factory.mktemp("rooms")
    write_blurred_room(folder / "room", np.random.default_rng(8), CAMERA, PROJECTOR)
    words = [
        "--camera",
        f"simulated:{folder / 'room'}",
        "--scheme",
        "multiplexed",
        "--full-well",
        "2000",
        "--shots",
        "1",
    ]
    assert acquire_transport.main([*words, "-o", str(folder / "acquired")]) == 0
    picture = cv2.resize(typical_pictures((6, 8))[0], CAMERA[::-1]).clip(0, 1)
    cv2.imwrite(str(folder / "picture.png"), np.round(255 * picture[..., None].repeat(3, 2) ** 0.45))
    return folder


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a calibration folder whose T is the truth."""
    folder = tmp_path_factory.mktemp("wall") / "wall"
    write_blurred_room(folder, np.random.default_rng(4), (54, 75), (45, 60))
    return folder


def verified(rooms: Path, *words: str) -> list[str]:
    camera = f"simulated:{rooms / 'room'}"
    return [str(rooms / "acquired"), str(rooms / "picture.png"), "--camera", camera, *words]


def test_feedback_comes_closer_and_the_best_round_is_written(rooms: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = rooms / "seen"
    assert verify_projection.main(verified(rooms, "--rounds", "2", "--repeats", "8", "-o", str(out))) == 0
    printed = capsys.readouterr().out
    figures = re.findall(r"round (\d): predicted (\S+) dB, measured (\S+) dB; .* to (\S+) dB", printed)
    assert [int(row[0]) for row in figures] == [0, 1, 2]
    predicted, measured, model = np.array([row[1:] for row in figures], float).T
    assert measured[0] < predicted[0]  # T is compared with itself, so its errors do not show
    assert measured[1:].max() > measured[0] + 0.1  # in decibels
    assert model.min() > 25
    assert {path.name for path in out.iterdir()} == {
        f"{n}.png" for n in ("projected", "desired", "predicted", "captured")
    }
    assert cv2.imread(str(out / "projected.png")).shape == (*PROJECTOR, 3)


def test_another_room_is_noticed(rooms: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_blurred_room(tmp_path / "other", np.random.default_rng(9), CAMERA, PROJECTOR)
    shutil.rmtree(rooms / "acquired" / "drift", ignore_errors=True)
    assert verify_projection.main([*verified(rooms)[:3], f"simulated:{tmp_path / 'other'}"]) == verify_projection.LOST
    said = capsys.readouterr().out
    assert re.fullmatch(
        r"\d+% of the floodlit room is brighter or darker .* acquire again; next: counterlight acquire .* --force\n",
        said,
    )
    assert not (rooms / "acquired" / "drift").exists()
    write_blurred_room(tmp_path / "large", np.random.default_rng(9), CAMERA, (12, 16))
    assert verify_projection.main([*verified(rooms)[:3], f"simulated:{tmp_path / 'large'}"]) == 2
    assert "the projector has 16x12 pixels, " in capsys.readouterr().err
    assert verify_projection.main([*verified(rooms)[:3], f"folder:{tmp_path}", "--projector", "21x30"]) == 2
    assert "the projector has 21x30 pixels, " in (line := capsys.readouterr().err)
    assert "is for 30x21; width and height are swapped" in line


def test_what_goes_without_a_picture_and_what_does_not(rooms: Path, capsys: pytest.CaptureFixture[str]) -> None:
    room, picture, *camera = verified(rooms)
    assert verify_projection.main([room, *camera]) == 0
    assert capsys.readouterr().out == f"nothing has changed; next: counterlight play {room} MEDIA\n"
    for words, complaint in (
        ([room, *camera, "--rounds", "2"], "are of a PICTURE"),
        ([room, picture, *camera, "--watch", "5"], "leave out PICTURE"),
        ([room, *camera, "--watch", "0"], "a number of seconds above 0"),
    ):
        assert verify_projection.main(words) == 2
        assert complaint in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["nosuch.png"], "nosuch.png: no such file"),
        (["notes.png"], "notes.png: frame 0 cannot be decoded"),
        (["small.exr"], "small.exr: an OpenEXR picture of 3x2 pixels, expected "),
        (["picture.png", "--solver", "map"], "manifest.toml: missing; rebuild it with"),
        (["picture.png", "--avoid-highlights"], "--avoid-highlights: of one projector"),
        (["picture.png", "--drift", "11"], "--drift 11.0: expected 0 to 10"),
        (["picture.png", "--repeats", "0"], "--repeats: expected a whole number of at least 1, found '0'"),
        (["picture.png", "--control", "notes.png"], "notes.png: no socket; is the player running with --control"),
        (["--drift", "11"], "--drift 11.0: expected 0 to 10"),
    ],
)
def test_nothing_is_shown_before_everything_is_checked(
    rooms: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    complaint: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(rooms / "picture.png", tmp_path)
    (tmp_path / "notes.png").write_text("no picture")
    exr.write_rgb(tmp_path / "small.exr", np.ones((2, 3, 3), np.float32))
    (tmp_path / "exchange").mkdir()
    camera = ["--camera", "folder:exchange", "--projector", f"{PROJECTOR[1]}x{PROJECTOR[0]}"]
    assert verify_projection.main([str(rooms / "acquired"), *camera, *words]) == 2
    assert complaint in capsys.readouterr().err
    assert list((tmp_path / "exchange").iterdir()) == []


def test_colours_that_the_projector_cannot_show_are_counted(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A primary alone gives 60 % of its share of white, and the left half of the picture is red."""
    stored = calibration.read(wall)
    samples = ((0.6,) * 3,) * (LEVELS**3 - 1) + ((1.0,) * 3,)
    dull = replace(stored.calibration.projector, response=Response("srgb", processing=Processing(samples)))
    with calibration.writing(tmp_path / "dull", replace(stored.calibration, projectors=(dull,))) as stage:
        write_transport(read_transport(stored), stage)
    picture = np.zeros((54, 75, 3), np.uint8)
    picture[:, :37, 2] = 255
    cv2.imwrite(str(tmp_path / "red.png"), picture)
    words = [str(tmp_path / "dull"), str(tmp_path / "red.png"), "--camera", f"simulated:{tmp_path / 'dull'}"]
    assert verify_projection.main([*words, "-o", str(tmp_path / "seen")]) == 0
    found = re.search(r"  (\S+) % of the pixels need brighter colours than", capsys.readouterr().out)
    assert found
    full = 100 * np.mean(cv2.imread(str(tmp_path / "seen" / "projected.png")).max(axis=2) == 255)
    assert full - 2 < float(found[1]) <= full + 0.1  # a loss of 2 % of white is ignored
    assert full > 10


# Changed rooms: the message, and whether the correction undoes the change.
CHANGES: dict[str, tuple[dict[str, Any], str, bool]] = {
    "picture": ({"shift": (0.8, 0.6)}, r"the projector's picture has moved by 0\.[78]\d, 0\.[56]\d pixels", True),
    "lamp": ({"light": (0.85, 0.9, 0.9)}, r"the projector's light is 8[45]\.\d%, (89|90)\.\d%, (89|90)\.\d% of", True),
    "daylight": ({"ambient": 4.0}, r"the room's light is \d\.\d+% of white, was", True),
    "camera": (
        {"camera": (1, 0)},
        r"the camera has moved by (1\.0|0\.9)\d, -?0\.0\d of its pixels: put it back",
        False,
    ),
    "all": ({"shift": (-0.5, 0.5), "camera": (0, 1)}, r"the camera has moved by -?0\.\d\d, (1\.0|0\.9)\d of", False),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_has_changed_is_distinguished(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str
) -> None:
    how, said, undone = CHANGES[change]
    stored = calibration.read(wall)
    shutil.rmtree(wall / "drift", ignore_errors=True)
    write_changed(tmp_path / "now", stored, **how)
    code = verify_projection.main([str(wall), "--camera", f"simulated:{tmp_path / 'now'}", "--no-preflight"])
    printed, _, action = capsys.readouterr().out.partition("; next: ")
    assert re.match(said, printed), printed
    assert action.startswith("counterlight play " if undone else "counterlight acquire --camera ")
    assert printed.count(";") == (0 if undone else 1)  # nothing else is reported
    assert (code, (wall / "drift").exists()) == ((0, True) if undone else (verify_projection.LOST, False))
    assert printed.endswith(": corrected") == undone


def test_nothing_is_corrected_unasked_and_what_came_back_is_forgotten(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = calibration.read(wall)
    shutil.rmtree(wall / "drift", ignore_errors=True)
    write_changed(tmp_path / "now", stored, shift=(0.8, 0.6))
    now, then = (["--no-preflight", "--camera", f"simulated:{room}"] for room in (tmp_path / "now", wall))
    assert verify_projection.main([str(wall), *now, "--no-correct"]) == 0
    assert ": not corrected; next: counterlight verify " in capsys.readouterr().out
    assert read_drift(stored) is None
    for camera, changes in ((now, True), (then, False)):
        assert verify_projection.main([str(wall), *camera]) == 0
        kept = read_drift(stored)
        assert kept is not None
        assert kept.changes == changes


def test_a_corrected_picture_arrives_as_it_would_have(wall: Path, tmp_path: Path) -> None:
    """A pixel of drift costs 7 dB here, and its correction returns 5 dB.

    Each camera pixel has its own paint, so neighbouring drives differ, and interpolation blurs them. The
    target is black where no light arrives after the move.
    """
    picture = np.zeros((54, 75), np.float32)
    picture[5:-5, 5:-5] = cv2.resize(typical_pictures((6, 8))[0], (65, 44)).clip(0, 1)
    cv2.imwrite(str(tmp_path / "picture.png"), np.round(255 * picture[..., None].repeat(3, 2) ** 0.45))
    write_blurred_room(tmp_path / "now", np.random.default_rng(4), (54, 75), (45, 60), shift=(0.8, 0.6))

    def measured(room: Path, *words: str) -> float:
        shutil.rmtree(wall / "drift", ignore_errors=True)
        output = io.StringIO()
        with redirect_stdout(output):
            command = [str(wall), str(tmp_path / "picture.png"), "--camera", f"simulated:{room}", *words]
            assert verify_projection.main([*command, "--no-preflight"]) == 0
        found = re.search(r"measured (\S+) dB", output.getvalue())
        assert found
        return float(found[1])

    before, drifted, corrected = measured(wall), measured(tmp_path / "now", "--no-correct"), measured(tmp_path / "now")
    assert drifted < before - 6
    assert corrected > before - 3


def test_a_folder_of_captures_goes_on_level_by_level(
    wall: Path, rooms: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """First black, white and the random picture, then the compensated picture, then its round of feedback."""
    stored = calibration.read(wall)
    shutil.rmtree(wall / "drift", ignore_errors=True)
    write_changed(tmp_path / "now", stored, shift=(0.8, 0.6))
    sensor = Sensor(bits=14, full_well=20000, read_noise=5)
    eye = SimulatedCamera(simulated_rooms(tmp_path / "now")[0], CameraSettings(sensor))
    height, width = stored.calibration.projector.shape
    exchange = tmp_path / "exchange"
    camera = ["--camera", f"folder:{exchange}", "--projector", f"{width}x{height}"]
    camera += ["--exposures", f"{eye.exposures.times[0]}"]
    command = [str(wall), str(rooms / "picture.png"), *camera, "--rounds", "1", "--repeats", "2"]
    for count in (3 * REPEATS, 2, 2):
        assert verify_projection.main(command) == 2
        assert f"waiting for {count} captures" in capsys.readouterr().err
        photograph(eye, exchange)
    assert verify_projection.main(command) == 0
    said = capsys.readouterr().out
    assert re.match(r"the projector's picture has moved by 0\.[78]\d, 0\.[56]\d pixels", said)
    assert "round 1: " in said
    assert re.search(r"\nthe picture arrives as predicted, \d\d\.\d dB; next: counterlight play .*\n$", said)
    assert [*(exchange / "patterns").iterdir(), *(exchange / "captures").iterdir()] == []
    assert verify_projection.main([str(wall), *camera]) == 2  # the next check numbers its captures separately
    assert min(path.name for path in (exchange / "patterns").iterdir()) == f"{3 * REPEATS + 4:05}.png"


def test_every_projector_of_a_raster_is_found_where_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    room = join(write_halves(tmp_path, right_response="linear"), tmp_path / "joint")
    stored = calibration.read(room)
    shifts = [(0.8, 0.6), (-1.5, 0.3)]
    write_changed(tmp_path / "now", stored, shifts=shifts)
    capsys.readouterr()
    assert verify_projection.main([str(room), "--camera", f"simulated:{tmp_path / 'now'}", "--no-preflight"]) == 0
    said = capsys.readouterr().out
    assert "projector 1's picture has moved by" in said
    assert "; projector 2's picture has moved by" in said
    drift = read_drift(stored)
    assert drift is not None
    for moved, device, shift in zip(drift.projectors, stored.calibration.projectors, shifts, strict=True):
        # A tenth of a pixel: where pictures overlap, the border of one lies inside the other.
        np.testing.assert_allclose(moved.at_corners(device)[0], shift, atol=0.1)


def test_a_watch_goes_on_until_it_is_ended_whether_or_not_a_player_listens(wall: Path, tmp_path: Path) -> None:
    room = shutil.copytree(wall, tmp_path / "room", ignore=shutil.ignore_patterns("drift"))
    write_changed(tmp_path / "now", calibration.read(room), shift=(0.8, 0.6))
    words = "--camera", f"simulated:{tmp_path / 'now'}", "--watch", "0.1", "--control", tmp_path / "nobody"
    with running(*verb("verify"), room, *words, "--no-preflight") as process:
        assert process.stdout
        assert process.stderr
        lines = [process.stdout.readline() for _ in range(3)]
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
        errors = process.stderr.read()
    assert all(re.match(r"the projector's picture has moved by .*: corrected\n", line) for line in lines)
    assert process.returncode == 130
    assert errors.count("nobody: no answer") >= 2


def test_captures_of_an_acquisition_are_no_check_s(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "captures").mkdir()
    (tmp_path / "captures" / "00000.png").write_bytes(b"somebody's")
    (tmp_path / "acquisition.toml").write_text('id = "0123"\n')
    size = "x".join(map(str, calibration.read(wall).calibration.projector.shape[::-1]))
    assert verify_projection.main([str(wall), "--camera", f"folder:{tmp_path}", "--projector", size]) == 2
    assert "holds captures of an acquisition" in capsys.readouterr().err
    assert (tmp_path / "captures" / "00000.png").exists()


def photograph(eye: SimulatedCamera, exchange: Path) -> None:
    """Save a capture of every pattern that has none yet, as a user's program does."""
    for path in sorted((exchange / "patterns").glob("*.png")):
        target = exchange / "captures" / path.name
        if not target.exists():
            shown = cv2.imread(str(path), cv2.IMREAD_COLOR)[..., ::-1]
            (shot,) = eye.capture(int(path.stem), np.ascontiguousarray(shown))
            cv2.imwrite(str(target), np.ascontiguousarray(shot[..., ::-1]))


class _Pictures(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.files: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.files |= {value for key, value in attrs if tag == "img" and key == "src" and value}


def test_the_acquisition_ends_with_its_report(rooms: Path) -> None:
    folder = rooms / "acquired.report"
    page = _Pictures()
    page.feed((folder / "index.html").read_text())
    assert page.files == {path.name for path in folder.glob("*.png")}
    assert {"floodlight.png", "black.png", "composition.png", "dual.png", "coverage.png"} < page.files
    figures = json.loads((folder / "report.json").read_text())
    assert [finding["grade"] for finding in figures["preflight"]] == ["good"] * len(CHECKS)
    room = calibration.read(rooms / "acquired").calibration
    assert figures["masked_camera_pixels"] == room.mask.sum()
    for promised in figures["predicted_psnr"].values():
        assert promised["with_check_error"] < promised["by_transport"]
    floodlight = cv2.imread(str(folder / "floodlight.png"))
    assert floodlight.shape == (*CAMERA, 3)


def test_the_share_inside_the_interval_of_a_room_is_printed(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All values are inside a very wide interval, and hardly any inside a very narrow interval."""
    stored = calibration.read(wall)
    picture = tmp_path / "picture.png"
    cv2.imwrite(str(picture), np.full((*stored.calibration.camera.shape, 3), 120, np.uint8))
    cells = tuple(-(-side // CELL) for side in stored.calibration.camera.shape)
    camera, shares = ("--camera", f"simulated:{wall}", "--no-preflight"), []
    for width in (1e3, 1e-9):
        room = tmp_path / f"{width}"
        with calibration.writing(room, stored.calibration) as stage:
            write_transport(read_transport(stored), stage)
            write_interval(Interval(np.full((3, 2), width**2), np.ones((*cells, 3), np.float32)), stage)
        assert verify_projection.main([str(room), str(picture), *camera]) == 0
        printed = capsys.readouterr().out
        found = COVERED.search(printed)
        assert found, printed
        shares.append([float(found[name]) for name in ("inside", "dark", "middle", "bright")])
        white = float(re.findall(r"white is a camera radiance of (\S+);", printed)[0])
        # w² = width² (1 + ĉ), with ĉ from 0 to white
        low, high = 200 * width / white, 200 * width / white * np.sqrt(1 + white)
        assert low - 0.006 <= float(found["width"]) <= high * 1.001 + 0.006  # two decimals are printed
    assert shares == [[100] * 4, pytest.approx([0] * 4, abs=2)]
    assert verify_projection.main([str(wall), str(picture), *camera]) == 0
    assert "interval" not in capsys.readouterr().out
