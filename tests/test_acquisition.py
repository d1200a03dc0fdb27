"""Acquisition of T in simulated rooms: interruptions, folders, bad captures, end to end."""

import filecmp
import json
import re
import resource
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy import sparse

from counterlight import calibration
from counterlight.calibration import Calibration, Device, writing
from counterlight.errors import InputError
from counterlight.files.picture_files import write_png
from counterlight.maps.room_maps import read_maps
from counterlight.pipeline.content import camera_psnr, reachable_white
from counterlight.pipeline.operators import compensation
from counterlight.response import parse_response
from counterlight.tools import acquire_transport, build_correction_map
from counterlight.tools.acquisition import store
from counterlight.tools.acquisition.cameras import simulated
from counterlight.tools.acquisition.cameras.camera import Exposures, Shot
from counterlight.tools.acquisition.cameras.simulated import (
    CameraSettings,
    SimulatedCamera,
    SimulatedRoom,
    simulated_rooms,
)
from counterlight.tools.acquisition.linearity import SHOTS, shown_halves
from counterlight.tools.acquisition.plan import REPEATS, Picture, Reference, measure_noise
from counterlight.tools.acquisition.ramps import light_level
from counterlight.tools.acquisition.schemes import blocks
from counterlight.tools.acquisition.schemes.graycode import GrayCodeScheme
from counterlight.tools.acquisition.schemes.hierarchical import HierarchicalScheme, Threshold
from counterlight.tools.acquisition.schemes.multiplexed import MultiplexedScheme
from counterlight.tools.acquisition.store import CaptureStore
from counterlight.tools.acquisition.summary import Coverage
from counterlight.tools.hdr.camera_response import exposure_table
from counterlight.tools.hdr.estimators import CpuSums, make_estimator
from counterlight.tools.inverse.pictures import typical_pictures
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import Transport, channels
from tests.acquired_rooms import (
    CAMERA,
    LINEAR,
    NOISY,
    PROJECTOR,
    SHAPE,
    dense,
    room_of,
    run,
    run_on_disk,
    sharp_wall,
    shown_by,
)
from tests.faults import no_file_above
from tests.programs import here, running, succeed, verb, wait_until
from tests.rooms import write_blurred_room

FIRST = 2 * REPEATS + 2 * SHOTS  # black, floodlight, and a picture and its complement
TAKEN = FIRST + len(light_level(PROJECTOR).patterns)  # captures before the first pattern of a scheme

# Interruptions.


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Returns the command's only error line."""
    capsys.readouterr()
    assert acquire_transport.main([str(word) for word in arguments]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    return lines[0]


def small_room(folder: Path, rng: np.random.Generator) -> Path:
    write_blurred_room(folder, rng, CAMERA, PROJECTOR)
    return folder


def same_files(one: Path, other: Path) -> None:
    names = sorted(path.name for path in one.iterdir())
    assert names == sorted(path.name for path in other.iterdir())
    assert filecmp.cmpfiles(one, other, names, shallow=False) == (names, [], [])


def test_killed_and_resumed_it_ends_bit_identical(tmp_path: Path, rng: np.random.Generator) -> None:
    room = small_room(tmp_path / "room", rng)
    words = "--camera", f"simulated:{room}", "--name", "twin"
    here("acquire", *words, "-o", tmp_path / "undisturbed")
    captures, output = tmp_path / "killed.captures", tmp_path / "killed"
    for wanted in (3, 40):
        with running(*verb("acquire"), *words, "-o", output) as process:
            last = captures / "captures" / f"{wanted - 1:05}.png"
            wait_until(last.exists, "captures", process, every_s=0.005)
        assert not output.exists()
        whole = sorted((captures / "captures").glob("0*.png"))
        assert len(whole) >= wanted
        assert [path.stem for path in whole] == [f"{number:05}" for number in range(len(whole))]
        same = tmp_path / "undisturbed.captures" / "captures"
        assert all(filecmp.cmp(path, same / path.name, shallow=False) for path in whole)
    printed = succeed("acquire", *words, "-o", output)
    assert f"{len(whole)} of them from before" in printed
    same_files(output, tmp_path / "undisturbed")
    same_files(captures / "captures", tmp_path / "undisturbed.captures" / "captures")


class FillingDisk(CaptureStore):
    """Disk that is full from capture 20 on."""

    def _put_shots(self, paths: Sequence[Path], shots: Sequence[Shot]) -> None:
        with no_file_above(200 if int(paths[0].stem) >= 20 else resource.RLIM_INFINITY):
            super()._put_shots(paths, shots)


def test_captures_are_compressed_and_read_as_they_were(tmp_path: Path, rng: np.random.Generator) -> None:
    noisy = (4 * rng.integers(100, 116, (60, 80, 3))).astype(np.uint16)
    wanted = store.Wanted(tmp_path / "room")
    with store.open_store(tmp_path / "captures", {"camera": "test"}, Exposures(), wanted) as captures:
        captures.save(0, [noisy])
        assert captures.has(0)  # waits for the disk
        assert (tmp_path / "captures" / "captures" / "00000.png").stat().st_size < noisy.nbytes / 2
        np.testing.assert_array_equal(captures.shots(0)[0], noisy)


def test_a_full_disk_stops_in_one_line_and_resumes(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    room, scheme = room_of(sharp_wall(rng)), HierarchicalScheme()
    message = r"captures/00020\.png: cannot be written \(File too large\); .*its space"
    with monkeypatch.context() as patch:
        patch.setattr(store, "CaptureStore", FillingDisk)
        with pytest.raises(InputError, match=message):
            run_on_disk(tmp_path, room, scheme)
    assert len(list((tmp_path / "captures" / "captures").iterdir())) == 20
    resumed, whole = run_on_disk(tmp_path, room, scheme), run(room, scheme)
    assert resumed.resumed == 20
    np.testing.assert_array_equal(dense(resumed.measured.transport), dense(whole.measured.transport))


def test_repeated_shots_are_kept_one_by_one_and_resumed_bit_identical(tmp_path: Path, rng: np.random.Generator) -> None:
    room = small_room(tmp_path / "room", rng)
    arguments = ["--camera", f"simulated:{room}", "--scheme", "graycode", "--shots", "3", "--name", "twin"]
    printed = here("acquire", *arguments, "-o", tmp_path / "undisturbed")
    pictures, exposures = map(int, re.search(r"(\d+) pictures, (\d+) exposures", printed).groups())  # type: ignore[union-attr]
    assert exposures == 3 * pictures
    captures = tmp_path / "undisturbed.captures" / "captures"
    assert len(list(captures.iterdir())) == exposures
    shutil.copytree(tmp_path / "undisturbed.captures", tmp_path / "torn.captures")
    unfinished(tmp_path / "torn.captures")
    for path in (tmp_path / "torn.captures" / "captures").iterdir():
        if path.stem == "00005_2" or int(path.stem[:5]) > 5:  # killed before the last shot of capture 5 was written
            path.unlink()
    printed = here("acquire", *arguments, "-o", tmp_path / "torn")
    assert "5 of them from before" in printed
    same_files(tmp_path / "torn", tmp_path / "undisturbed")
    same_files(tmp_path / "torn.captures" / "captures", captures)


def unfinished(captures: Path) -> None:
    """Restore the state of a run that was killed before its room was in place."""
    session = captures / "session.toml"
    lines = [line for line in session.read_text().splitlines() if not line.startswith(("made", "finished"))]
    session.write_text("\n".join(lines))


def test_a_simulated_camera_takes_what_simulate_takes_and_refuses_before_it_simulates(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    room = small_room(tmp_path / "room", rng)
    shutil.copy(shipped_scenes()["wall"], tmp_path / "own.toml")
    monkeypatch.setattr(simulated, "simulate", lambda scene: pytest.fail("a scene was simulated"))
    for name, size in (("corner", "384x216"), (str(tmp_path / "own.toml"), "384x216"), (str(room), "30x21")):
        words = "--camera", f"simulated:{name}", "-o", tmp_path / "out"
        assert f"{size} pixels; leave it out" in refusal(capsys, *words, "--projector", "9x9")
        assert "--bits 17: expected 1 to 16" in refusal(capsys, *words, "--bits", "17")
    for name, complaint in (("corne", "did you mean 'corner'?"), ("nosuch/a", "nosuch/a: missing")):
        assert complaint in refusal(capsys, "--camera", f"simulated:{name}", "-o", tmp_path / "out")


def test_captures_of_other_options_are_not_mixed(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    room = small_room(tmp_path / "room", rng)
    arguments = ["--camera", f"simulated:{room}", "--scheme", "multiplexed", "-o", str(tmp_path / "out")]
    assert acquire_transport.main(arguments) == 0
    unfinished(tmp_path / "out.captures")
    for change, key in (
        (["--seed", "1"], "camera"),
        (["--exposures", "1,0.5"], "camera"),
        (["--tile", "5"], "tile"),
        (["--shots", "2"], "camera"),
    ):
        assert f"captures of another acquisition ({key}: " in refusal(capsys, *arguments, *change, "--force")
    shutil.rmtree(tmp_path / "out.captures")
    (tmp_path / "out.captures").mkdir()
    (tmp_path / "out.captures" / "letter.txt").write_text("dear")
    assert "holds no captures of an acquisition" in refusal(capsys, *arguments, "--force")


def test_captures_from_before_faint_light_was_left_are_not_mixed(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Newer versions divide the blocks of a wide raster by another rule, so that the later pictures differ."""
    arguments = ["--camera", f"simulated:{small_room(tmp_path / 'room', rng)}", "--shots", "1", "-o"]
    assert acquire_transport.main([*arguments, str(tmp_path / "out")]) == 0
    unfinished(tmp_path / "out.captures")
    monkeypatch.setattr(blocks, "WIDE", 1)
    refused = refusal(capsys, *arguments, tmp_path / "out", "--force")
    assert "captures of another acquisition (even: None there, 'whole' here); name another folder" in refused


# A folder as camera.


def test_a_folder_asks_level_by_level_and_ends_as_the_camera_itself(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    room = small_room(tmp_path / "room", rng)
    # A folder camera also takes one shot, because its captures have no known pace.
    here("acquire", "--camera", f"simulated:{room}", "--shots", "1", "-o", tmp_path / "direct")
    eye = SimulatedCamera(simulated_rooms(room)[0], CameraSettings())
    exchange = tmp_path / "exchange"
    arguments = ["--camera", f"folder:{exchange}", "--projector", "30x21"]
    arguments += ["--exposures", str(eye.exposures.times[0]), "-o", str(tmp_path / "asked")]
    rounds = 0
    while acquire_transport.main(arguments) != 0:
        shown = sorted((exchange / "patterns").iterdir())
        waiting = [path for path in shown if not (exchange / "captures" / path.name).exists()]
        assert f"waiting for {len(waiting)} captures, {waiting[0].name}" in capsys.readouterr().err
        for path in waiting:
            (shot,) = eye.capture(int(path.stem), shown_by(path))
            cv2.imwrite(str(exchange / "captures" / path.name), shot[..., ::-1])
        rounds += 1
    assert rounds == 3 + 5  # black and floodlight, ramps, levels of 16 to 1 px, floodlight and checks
    kinds = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED).ndim for path in shown]
    assert [number for number, kind in enumerate(kinds) if kind == 3] == [*range(FIRST, TAKEN), len(shown) - 1]
    names = [path.name for path in (tmp_path / "direct").iterdir() if path.name != "calibration.toml"]
    assert len(names) == 3 + 1 + 3 + 3  # T of three channels and far, primaries, ambient light, mask, interval
    assert filecmp.cmpfiles(tmp_path / "direct", tmp_path / "asked", names, shallow=False) == (names, [], [])
    one, other = (calibration.read(tmp_path / name).calibration for name in ("direct", "asked"))
    assert one.projector == other.projector  # the responses are compared, too


def prepared_folder(tmp_path: Path, rng: np.random.Generator) -> tuple[list[str], Path]:
    """Folder with captures of black and floodlight."""
    eye = SimulatedCamera(room_of(sharp_wall(rng)), CameraSettings())
    captures = tmp_path / "x" / "captures"
    captures.mkdir(parents=True)
    shown = [np.full(PROJECTOR, lit) for _ in range(REPEATS) for lit in (False, True)] + shown_halves(PROJECTOR)
    for number, pattern in enumerate(shown):
        (shot,) = eye.capture(number, pattern)
        cv2.imwrite(str(captures / f"{number:05}.png"), shot[..., ::-1])
    arguments = ["--camera", f"folder:{tmp_path / 'x'}", "--projector", "30x21", "-o", str(tmp_path / "out")]
    return [*arguments, "--exposures", str(eye.exposures.times[0])], captures


def other_size(captures: Path) -> None:
    cv2.imwrite(str(captures / "00002.png"), np.zeros((CAMERA[1], CAMERA[0]), np.uint8))


def cut_off(captures: Path) -> None:
    path = captures / "00003.png"
    path.write_bytes(path.read_bytes()[:-30])


def filled(value: int, *numbers: int) -> Any:
    def damage(captures: Path) -> None:
        for number in numbers:
            cv2.imwrite(str(captures / f"{number:05}.png"), np.full((*CAMERA, 3), value, np.uint16))

    return damage


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda captures: (captures / "00001.png").unlink(), r"waiting for 1 captures, 00001\.png; show the patterns"),
        (
            lambda captures: shutil.copy(captures / "00001.png", captures / f"{FIRST:05}.png"),
            f"{FIRST:05}.png: belongs to no pattern",
        ),
        (lambda captures: shutil.copy(captures / "00001.png", captures / "img.jpg"), "img.jpg: belongs to no pattern"),
        (lambda captures: shutil.copy(captures / "00001.png", captures / "00001.jpg"), "the same capture as 00001"),
        (other_size, r"00002\.png: 18x26, the captures before are 26x18"),
        (cut_off, r"00003\.png: .* ends after"),
        (filled(65535, *range(1, 2 * REPEATS, 2)), "saturates 100 % of the camera's pixels"),
        (filled(0, *range(2 * REPEATS)), "from black to floodlight 0 of 468 camera pixels rise"),
    ],
)
def test_bad_captures_are_refused(
    tmp_path: Path, rng: np.random.Generator, damage: Any, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, captures = prepared_folder(tmp_path, rng)
    damage(captures)
    assert re.search(message, refusal(capsys, *arguments))
    assert not (tmp_path / "out").exists()


class Spoilt:
    """Camera that changes its captures from `start` on with `spoil`."""

    def __init__(self, room: SimulatedRoom, start: int, spoil: Any, end: int = 10**6) -> None:
        self._camera, self._numbers, self._spoil = SimulatedCamera(room, NOISY), range(start, end), spoil

    name = "spoilt"

    @property
    def exposures(self) -> Exposures:
        return self._camera.exposures

    def prepare(self, first: int, patterns: Sequence[Picture], missing: Sequence[int]) -> None:
        pass

    def capture(self, number: int, picture: Picture) -> tuple[Shot, ...]:
        shots = self._camera.capture(number, picture)
        return tuple(map(self._spoil, shots)) if number in self._numbers else shots


def test_a_moved_camera_is_noticed(tmp_path: Path, rng: np.random.Generator) -> None:
    room = room_of(sharp_wall(rng))
    pictures = run(room, GrayCodeScheme()).pictures
    moved = Spoilt(room, pictures - 3, lambda shot: np.roll(shot, 1, axis=1))
    with pytest.raises(InputError, match=r"the floodlit room now differs by .* moved"):
        run(room, GrayCodeScheme(), camera=moved)
    dimmed = Spoilt(room, pictures - 3, lambda shot: (shot * 0.9).astype(shot.dtype))
    with pytest.raises(InputError, match=r"the floodlit room is now 90 % as bright"):
        run(room, GrayCodeScheme(), camera=dimmed)


def test_a_capture_of_the_wrong_moment_is_noticed(tmp_path: Path, rng: np.random.Generator) -> None:
    room = room_of(sharp_wall(rng))
    for scheme in (HierarchicalScheme(), MultiplexedScheme()):
        for number in (0, 14) if isinstance(scheme, HierarchicalScheme) else (12, 17):
            number += TAKEN
            black = Spoilt(room, number, np.zeros_like, number + 1)
            with pytest.raises(InputError, match=r"do not add up to the floodlit room in .* is black"):
                run(room, scheme, camera=black)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--camera", "webcam"], "--camera webcam: expected simulated:SCENE|CALIBRATION"),
        (["--camera", "v4l2:99", "--window"], "--camera v4l2: needs exposure times in seconds"),
        (["--camera", "v4l2:99", "--exposures", "0.03"], "where is the projector"),
        (["--camera", "v4l2:99", "--exposures", "0.03", "--window"], "/dev/video99: no such camera, found: "),
        (["--camera", "simulated:ROOM", "--lag", "21"], "--lag 21: expected 0 to 20 frames"),
        (["--camera", "folder:x"], "needs the projector's size"),
        (["--camera", "simulated:absent.toml"], "absent.toml: missing"),
        (["--camera", "simulated:ROOM", "--projector", "9x9"], "has 30x21 pixels; leave it out"),
        (["--camera", "simulated:ROOM", "--projector", "21x30"], "has 30x21 pixels; width and height are swapped"),
        (["--camera", "simulated:ROOM", "--threshold", "much"], "--threshold much: expected a multiple"),
        (["--camera", "simulated:ROOM", "--threshold", "-1"], "--threshold"),
        (["--camera", "simulated:ROOM", "--threshold", ""], "--threshold : expected a multiple"),
        (["--camera", "simulated:ROOM", "--tile", "9"], "--tile 9: of no meaning to --scheme hierarchical"),
        (
            ["--camera", "simulated:ROOM", "--threshold", "0.01"],
            "--threshold 0.01: less than the noise",
        ),
        (["--camera", "simulated:ROOM", "--threshold", "radiance=0"], "--threshold 0: expected a radiance above 0"),
        (["--camera", "simulated:ROOM", "--bits", "17"], "--bits 17: expected 1 to 16"),
        (["--camera", "simulated:ROOM", "--seed", "-1"], "--seed -1: expected 0 or more"),
        (["--camera", "simulated:ROOM", "--wait", "nan"], "--wait: expected a number of seconds, 0 or more"),
        (["--camera", "simulated:ROOM", "--exposures", "1,0"], "expected one or more numbers above 0"),
        (["--camera", "simulated:ROOM", "--shots", "0"], "--shots: expected a number of shots from 1 to 256"),
        (["--camera", "simulated:ROOM", "--scheme", "multiplexed", "--tile", "99"], "--tile 99: expected 4 to 14"),
        (["--camera", "simulated:ROOM", "--exposures", "40"], "saturation: .* are at the top: expose less"),
        (
            ["--camera", "simulated:ROOM", "--exposures", "40", "--no-preflight"],
            "saturates .* shorten the exposure",
        ),
    ],
)
def test_wrong_use_is_refused(
    tmp_path: Path, rng: np.random.Generator, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    room = small_room(tmp_path / "room", rng)
    words = [word.replace("ROOM", str(room)) for word in arguments]
    assert re.search(message, refusal(capsys, *words, "-o", tmp_path / "out"))
    assert not (tmp_path / "out").exists()


# End to end.


def small_scene(tmp_path: Path, name: str) -> Path:
    """Shipped scene at a small size."""
    text = (Path(__file__).parents[1] / "calib_data" / "scenes" / f"{name}.toml").read_text()
    small = {"width = 384": "width = 64", "height = 216": "height = 48", "width = 480": "width = 56"}
    for old, new in {**small, "height = 270": "height = 42", "cells = 700": "cells = 150"}.items():
        text = text.replace(old, new)
    path = tmp_path / f"{name}.toml"
    path.write_text(text)
    return path


def seen_through_truth(folder: Path, desired: np.ndarray, truth: Transport, room: Calibration) -> np.ndarray:
    """Camera picture in the true room when the map of `folder` compensates."""
    stored = calibration.read(folder)
    drive = compensation(read_maps(stored)).apply(desired - stored.calibration.ambient)
    light = truth.apply(np.clip(drive, 0, 1).reshape(-1, 3)).reshape(desired.shape)
    return np.asarray(light + room.ambient)


@pytest.fixture(scope="module")
def true_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Simulated and built; its scene is next to it."""
    folder = tmp_path_factory.mktemp("true")
    here("simulate", small_scene(folder, "wall"), "-o", folder / "true")
    here("build", folder / "true")
    return folder / "true"


@pytest.mark.parametrize("scheme", ["hierarchical", "multiplexed"])
def test_acquired_built_and_compensated_it_is_close_to_the_true_room(
    true_room: Path, tmp_path: Path, scheme: str
) -> None:
    scene = true_room.with_name("wall.toml")
    rig = "--camera", f"simulated:{scene}", "--scheme", scheme
    printed = here("acquire", *rig, "-o", tmp_path / "acquired", "--verbose")
    said = r"\d+ pictures, \d+ exposures", r"coverage: \d", r"clusters: \d+", r"check: .* predicted to \d"
    for pattern in (*said, r"light outside: [\d.]+ % of the projector's light"):
        assert re.search(pattern, printed)
    assert build_correction_map.main([str(tmp_path / "acquired")]) == 0
    stored = calibration.read(true_room)
    truth, room = read_transport(stored), stored.calibration
    acquired = calibration.read(tmp_path / "acquired").calibration
    codes = np.linspace(0, 1, 256)[:, None].repeat(3, axis=1)
    found, true = (each.projector.response.to_linear(codes) for each in (acquired, room))
    np.testing.assert_allclose(
        found, true, atol=2e-3
    )  # sRGB bends below the first of 17 levels; noise is 10 times smaller
    np.testing.assert_allclose(acquired.ambient, room.ambient, atol=4e-3)  # the limit is 10 σ of two dark captures
    assert np.mean(acquired.mask == room.mask) > 0.95
    flood = truth.composition().reshape(*room.camera.shape, 3) + room.ambient
    white = reachable_white(flood, room.mask)
    desired = white * np.repeat(typical_pictures(room.camera.shape)[0][..., None], 3, axis=2)
    figures = [
        camera_psnr(desired, seen_through_truth(folder, desired, truth, room), room.mask & acquired.mask, white)
        for folder in (true_room, tmp_path / "acquired")
    ]
    assert figures[1] > figures[0] - 0.5  # in dB, with the default camera's noise
    expected = json.loads((tmp_path / "acquired.report" / "report.json").read_text())["expected"]["decibels"]
    drive = np.random.default_rng(3).uniform(0, 1, (12, 16, 3)).repeat(4, axis=0).repeat(4, axis=1).reshape(-1, 3)
    seen = [
        T.apply(drive).reshape(flood.shape) for T in (truth, read_transport(calibration.read(tmp_path / "acquired")))
    ]
    seen = [light + each.ambient for light, each in zip(seen, (room, acquired), strict=True)]
    # Noise counts as at most nine tenths of the error in the checks; the room may therefore be better than expected.
    assert 45 < expected < camera_psnr(*seen, acquired.mask, white) + 1

    picture = tmp_path / "picture.png"
    write_png(
        picture, np.rint(255 * typical_pictures(room.camera.shape)[0][..., None].repeat(3, axis=2)).astype(np.uint8)
    )
    printed = here("verify", tmp_path / "acquired", picture, "--camera", f"simulated:{scene}", "--repeats", "1")
    inside = re.search(r"(\S+) % of the captured values are inside the 90 % interval", printed)
    assert inside
    assert float(inside[1]) == pytest.approx(90, abs=5)


@pytest.mark.parametrize("hidden", [0, 8])
def test_the_next_command_and_missing_coverage_are_said(
    hidden: int, tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both the next command and the missing coverage are printed.

    hidden : columns at the left of the projector picture that light nothing in the camera's view.
    """
    device, ambient = Device(*CAMERA, LINEAR), np.full((*CAMERA, 3), 0.01, np.float32)
    visible = sparse.diags_array(np.float32(np.arange(SHAPE[1]) % PROJECTOR[1] >= hidden))
    near = tuple(sparse.csr_array(each @ visible) for each in channels(sharp_wall(rng).near))
    room = Calibration("wall", "test", (Device(*PROJECTOR, LINEAR),), device, ambient, np.ones(CAMERA, np.bool_))
    with writing(tmp_path / "wall", room) as stage:
        write_transport(Transport.from_matrices(near), stage)
    output = tmp_path / "a room"
    words = ["--camera", f"simulated:{tmp_path / 'wall'}", "--shots", "1", "--no-preflight", "-o", str(output)]
    assert acquire_transport.main(words) == 0
    printed = capsys.readouterr()
    first, *_, last = printed.out.splitlines()
    result, action = last.split("; next: ")
    coverage = rf"{output}: measured, \d+\.\d % of the projector's pixels seen"
    said = re.fullmatch(rf"{coverage}, captures match the prediction to (.*) dB \((\w+ .*errors)\)", result)
    assert said
    assert first.startswith(
        f"expected on the wall: {said[2]}. A capture matches its prediction to about {said[1]} dB, and 9 of 10"
    )
    assert f"<p>{first}</p>" in (tmp_path / "a room.report" / "index.html").read_text()
    mask = calibration.read(output).calibration.mask
    assert f" seen, {mask.sum()} of {mask.size} camera pixels in the mask\n" in printed.out
    assert action == f"counterlight build '{output}'"
    assert "clusters" not in printed.out
    exposures = len(list((tmp_path / "a room.captures").rglob("*.png")))
    announced = re.match(r"acquisition: about (\d+) exposures of \d+ pictures, \d+ s, 1 MB\n", printed.err)
    assert announced
    assert int(announced[1]) == pytest.approx(exposures, rel=0.25)
    found = re.findall(
        "warning: coverage: the camera sees (.*) % of .*; it misses pixels at the edges (.*): turn", printed.err
    )
    assert found == ([("73.3", "(left 8)")] if hidden else [])


def test_each_cause_of_missing_coverage_has_its_advice() -> None:
    seen = np.zeros((20, 30), np.bool_)
    seen[1:18, 3:] = True
    (warning,) = Coverage(seen).warnings
    assert "76.5 % of the projector's pixels" in warning
    assert "it misses pixels at the edges (top 1, bottom 2, left 3): turn" in warning
    assert "in between" not in warning
    seen[:] = True
    assert Coverage(seen).warnings == []
    seen[::2, ::2] = False
    seen[:, 0] = seen[0] = True
    (warning,) = Coverage(seen).warnings
    assert "misses 21.0 % of the pixels in between: give the camera as many pixels" in warning
    assert "edges" not in warning


@pytest.mark.parametrize("text", ["4", "4x", "4.0", "radiance=0.01"])
def test_a_threshold_is_a_multiple_of_the_noise_unless_it_says_radiance(
    tmp_path: Path, rng: np.random.Generator, text: str
) -> None:
    room = small_room(tmp_path / "room", rng)
    words = ["--camera", f"simulated:{room}", "--scheme", "graycode", "--no-preflight", "-o", str(tmp_path / "out")]
    assert acquire_transport.main([*words, "--threshold", text]) == 0
    said = (tmp_path / "out.captures" / "session.toml").read_text()
    expected = Threshold(absolute=0.01) if text.startswith("radiance") else Threshold(sigmas=4.0)
    assert f'threshold = "{expected}"' in said


def test_a_scene_without_a_lit_pixel_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dark = Transport.from_matrices((sparse.csr_array((SHAPE[0], SHAPE[1]), dtype=np.float32),) * 3)
    room = Calibration(
        "dark", "made by a test", (Device(*PROJECTOR, LINEAR),), Device(*CAMERA, LINEAR),
        np.full((*CAMERA, 3), 0.1, np.float32), np.ones(CAMERA, bool),
    )  # fmt: skip
    with writing(tmp_path / "dark", room) as stage:
        write_transport(dark, stage)
    line = refusal(capsys, "--camera", f"simulated:{tmp_path / 'dark'}", "-o", tmp_path / "out")
    assert "projector: white instead of black changes 0.00 % of the camera's picture: switch the projector on" in line


def test_the_reference_knows_the_noise_of_faint_light(rng: np.random.Generator) -> None:
    black, white = (rng.normal(level, [0.01, 0.02, 0.04], (REPEATS, 60, 80, 3)) for level in (0.1, 0.1 + 1e-4))
    noise = measure_noise(list(black), list(white))
    room = Reference(black.mean(axis=0), white.mean(axis=0), noise, np.zeros((60, 80), bool), REPEATS)
    # error of a median over 4800 pixels: 1 %
    np.testing.assert_allclose(room.light.std(axis=0), room.rise_noise, rtol=0.05)


def test_the_reference_tells_light_from_black() -> None:
    black, white = np.full((2, 3, 3), 0.25), np.full((2, 3, 3), 1.0)
    noise = measure_noise([black, black], [white, white])
    room = Reference(black, white, noise, np.zeros((2, 3), bool))
    np.testing.assert_array_equal(room.light, np.full((6, 3), 0.75))


@pytest.mark.parametrize("response", ["linear", "srgb"])
@pytest.mark.parametrize(("dtype", "colours"), [(np.uint8, 1), (np.uint16, 1), (np.uint16, 3)])
def test_one_shot_has_the_radiance_that_the_sums_of_a_bracket_give(
    rng: np.random.Generator, response: str, dtype: type, colours: int
) -> None:
    """The lookup table of a single shot equals the sums bit for bit, for every code, grey and in colour."""
    codes = np.arange(np.iinfo(dtype).max + 1).astype(dtype).reshape(-1, 16)
    shot = codes if colours == 1 else rng.permuted(np.repeat(codes[..., None], 3, axis=2), axis=0)
    exposures = Exposures((0.37,), parse_response(response))
    levels = int(np.iinfo(dtype).max) + 1
    estimator = make_estimator("average", exposure_table(exposures.response, levels, 3), np.ones(levels))
    sums = CpuSums(estimator, (*shot.shape[:2], 3))
    sums.add(shot if colours == 3 else np.repeat(shot[..., None], 3, axis=2), estimator.coefficients(0.37), 0.37)
    np.testing.assert_array_equal(exposures.radiance([shot]), np.abs(sums.estimate()))
