"""Outputs that would overwrite an input, or cannot be written, are refused in one line, and no file changes."""

import importlib
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import sparse

from counterlight.tools import acquire_transport, build_correction_map
from counterlight.tools.shipped import CLIP
from tests.brackets import CURVES, random_scene, write_bracket
from tests.programs import ROOT
from tests.rooms import write_one_to_one_room

SHAPE = (6, 9)
SCENE = ROOT / "calib_data" / "scenes" / "wall.toml"
INPUT = "would overwrite .*, which is read; choose another name"
IN_ROOM = "is inside the calibration folder .*; choose a place outside"
IN_CAPTURES = "is inside the capture folder .*; choose a place outside"
HOLDS = "would be replaced, and .*is read; choose another folder"
STRANGER = "is no part of .* and would be lost; move it out of"
SHOTS = "shots/shot00.png shots/shot01.png shots/shot02.png shots/shot03.png --times 1 2 4 8 --response linear"
MATRICES = "--red T.npz --green T.npz --blue T.npz --camera 9x6 --projector 9x6"


@pytest.fixture(scope="module")
def furnished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with inputs of every command, protected files, and links to them."""
    folder = tmp_path_factory.mktemp("furnished")
    rng = np.random.default_rng(5)
    write_one_to_one_room(folder / "room", SHAPE)
    assert build_correction_map.main([str(folder / "room"), "--regularize", "0.1"]) == 0
    camera = ["--camera", f"simulated:{folder / 'room'}", "--scheme", "graycode", "--no-preflight"]
    assert acquire_transport.main([*camera, "-o", str(folder / "acquired")]) == 0
    shutil.copy(CLIP, folder / "clip.mp4")
    os.link(folder / "clip.mp4", folder / "hard.mp4")
    (folder / "soft.mp4").symlink_to("clip.mp4")
    (folder / "list.m3u").write_text("clip.mp4\n")
    (folder / "list.json").symlink_to("list.m3u")
    for number in range(3):
        cv2.imwrite(str(folder / f"f{number}.png"), rng.integers(0, 256, (*SHAPE, 3), np.uint8))
    os.link(folder / "f1.png", folder / "g0.png")
    cv2.imwrite(str(folder / "2021.png"), np.zeros((2, 2), np.uint8))
    write_bracket(folder / "shots", random_scene(rng, (48, 64, 3)), [1, 2, 4, 8], CURVES["linear"])
    (folder / "ramp.csv").write_text("level,grey\n" + "".join(f"{level},{level}\n" for level in range(0, 256, 17)))
    (folder / "curve.toml").write_text('response = "srgb"\n')
    shutil.copy(SCENE, folder / "scene.toml")
    sparse.save_npz(folder / "T.npz", sparse.csr_array(sparse.eye_array(54, dtype=np.float32)))
    (folder / "plain").mkdir()
    (folder / "plain" / "letter.txt").write_text("dear")
    shutil.copytree(folder / "room", folder / "own")
    (folder / "own" / "letter.txt").write_text("dear")
    shutil.copytree(folder / "acquired.report", folder / "noted")
    (folder / "noted" / "letter.txt").write_text("dear")
    os.mkfifo(folder / "pipe.png")
    (folder / "pictures.png").mkdir()
    return folder


def state(folder: Path) -> dict[str, object]:
    """Return the inode and content of every path in a folder, hidden paths included."""
    return {
        str(path.relative_to(folder)): (path.lstat().st_ino, path.read_bytes() if path.is_file() else None)
        for path in sorted(folder.rglob("*"))
    }


REFUSED = [
    # The medium, its playlist or one of its frames, under any name.
    ("app room clip.mp4 --output clip.mp4", INPUT),
    ("app room clip.mp4 --output ./plain/../clip.mp4", INPUT),
    ("app room clip.mp4 --output hard.mp4", INPUT),
    ("app room clip.mp4 --output soft.mp4", INPUT),
    ("app room soft.mp4 --output clip.mp4", INPUT),
    ("app room list.m3u --output clip.mp4", INPUT),
    ("app room f%d.png --output f%d.png", INPUT),
    ("app room f%d.png --output f2.png", INPUT),
    ("app room f1.png --output f%d.png", INPUT),
    ("app room f1.png --output g%d.png", INPUT),
    ("app room clip.mp4 --output o.png --stats clip.mp4", INPUT),
    ("app room list.m3u --output o.png --stats list.json", INPUT),
    ("app room clip.mp4 --output o.png --stats o.png", "would be overwritten by"),
    ("app room clip.mp4 --output o.png --heartbeat clip.mp4", "is no log that lines could be added to"),
    ("app room clip.mp4 --output o.png --heartbeat o.png", "would be overwritten by"),
    ("app room clip.mp4 --output %d.png", "2021.png is there and is of no sequence numbered from 0"),
    ("tools.compensate_image room f0.png --solver direct -o f0.png", INPUT),
    ("tools.relight room f0.png -o f0.png", INPUT),
    (
        f"tools.merge_exposures {SHOTS} -o o.exr --save-response shots/shot01.png",
        "cannot write .png; use .toml",
    ),
    (f"tools.merge_exposures {SHOTS} --response curve.toml -o o.exr --save-response curve.toml", INPUT),
    ("tools.fit_projector_response ramp.csv -o ramp.csv", "cannot write .csv; use .toml"),
    ("tools.fit_projector_response ramp.csv --camera-response curve.toml -o curve.toml", INPUT),
    # Folders that are protected as a whole.
    ("app room clip.mp4 --output room/o.png", IN_ROOM),
    ("app room clip.mp4 --output o.png --stats room/correction/s.json", IN_ROOM),
    ("app room clip.mp4 --output acquired.captures/captures/00001.png", IN_CAPTURES),
    ("tools.compensate_image room f0.png -o room/mask.png", IN_ROOM),
    ("tools.relight room -o room/ambient.exr", IN_ROOM),
    (f"tools.merge_exposures {SHOTS} -o room/ambient.exr", IN_ROOM),
    ("tools.fit_projector_response ramp.csv -o room/calibration.toml", IN_ROOM),
    ("tools.build_correction_map room --report room/report", IN_ROOM),
    ("tools.build_correction_map room --report room", HOLDS),
    ("tools.build_correction_map room --report .", "would be replaced, and is the current folder"),
    ("tools.simulate_transport scene.toml -o ..", "would be replaced, and contains the current folder"),
    ("tools.acquire_transport --camera simulated:room -o .", "would be replaced, and is the current folder"),
    ("tools.acquire_transport --camera simulated:room --output=", "is empty; expected a path"),
    ("tools.build_correction_map room --report noted", STRANGER),
    ("tools.simulate_transport scene.toml -o room/inner", IN_ROOM),
    ("tools.simulate_transport scene.toml -o own --force", STRANGER),
    ("tools.simulate_transport scene.toml -o plain --force", "exists and is no calibration folder"),
    ("tools.simulate_transport room/calibration.toml -o room --force", HOLDS),
    (f"tools.import_transport {MATRICES} --ambient room/ambient.exr -o room --force", HOLDS),
    ("tools.join_projectors room acquired -o room --force", HOLDS),
    ("tools.acquire_transport --camera simulated:room -o room --force", HOLDS),
    ("tools.acquire_transport --camera simulated:room -o new --captures new", "would be overwritten by"),
    (
        "tools.acquire_transport --camera simulated:room -o new --captures new/captures",
        "would be overwritten by",
    ),
    ("tools.acquire_transport --camera simulated:room -o new --captures plain", "holds no captures"),
    ("tools.acquire_transport --camera simulated:room -o new --captures room/x", IN_ROOM),
    (
        "tools.acquire_transport --camera simulated:room -o new --report acquired",
        "exists and is no report",
    ),
    (
        "tools.acquire_transport --camera simulated:room -o new --captures acquired.captures",
        "is finished; take new",
    ),
    (
        "tools.verify_projection room f0.png --camera simulated:room -o plain",
        "exists; name another folder",
    ),
    ("tools.study_accuracy room -o room", HOLDS),
    # Places where no such output can be.
    ("app room clip.mp4 --output nowhere/o.png", "nowhere: no such folder; make it first"),
    ("app room clip.mp4 --output clip.mp4/o.png", "clip.mp4: is a file; choose a folder for o.png"),
    ("app room clip.mp4 --output pictures.png", "is a folder; name a file"),
    ("app room clip.mp4 --output pipe.png", "is a device, a pipe or a socket; name a file"),
    ("app room clip.mp4 --output o.png --stats /dev/null", "is a device, a pipe or a socket; name a file"),
    ("app room clip.mp4 --output o.png --heartbeat plain", "is a folder; name a file"),
    ("app room clip.mp4 --output o.png --heartbeat nowhere/log", "no such folder; make it first"),
    ("tools.compensate_image room f0.png -o o.jpg", "cannot write .jpg; use .png, .exr"),
    ("tools.relight room -o nowhere/o.png", "nowhere: no such folder; make it first"),
    (f"tools.merge_exposures {SHOTS} -o nowhere/o.exr", "nowhere: no such folder; make it first"),
    ("tools.fit_projector_response ramp.csv -o nowhere/o.toml", "nowhere: no such folder; make it first"),
    ("tools.simulate_transport scene.toml -o clip.mp4", "clip.mp4: is a file; name a folder"),
    (
        "tools.simulate_transport scene.toml -o clip.mp4/room",
        "clip.mp4: is a file; choose a folder for room",
    ),
    ("tools.build_correction_map room --report clip.mp4", "clip.mp4: is a file; name a folder"),
]


@pytest.mark.parametrize(("command", "complaint"), REFUSED, ids=[command for command, _ in REFUSED])
def test_outputs_are_refused_before_any_work(
    command: str,
    complaint: str,
    furnished: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = state(furnished)
    monkeypatch.chdir(furnished)
    module, *words = command.split()
    main: Callable[[list[str]], int] = importlib.import_module(f"counterlight.{module}").main
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert re.search(complaint, line), line
    assert state(furnished) == before


def test_a_current_folder_that_is_gone_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert build_correction_map.main(["room"]) == 2
    assert capsys.readouterr().err == "error: the current folder no longer exists; change to another one (cd)\n"
