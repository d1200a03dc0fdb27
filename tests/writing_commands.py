"""Every command that writes, on small data: its arguments, existing outputs before it, and its results."""

import shutil
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from scipy import sparse

from counterlight import calibration
from counterlight.files.picture_files import read_picture
from counterlight.files.reading import read_toml
from counterlight.tools import build_correction_map
from counterlight.tools.shipped import CLIP
from tests.brackets import CURVES, random_scene, write_bracket
from tests.pairs_of_rooms import Wall, write_pairs
from tests.programs import ROOT
from tests.rooms import write_blurred_room
from tests.stage import Stage
from tests.test_graycode import PROJECTOR, make_rig, write_opencv_captures

SCENE = ROOT / "calib_data" / "scenes" / "wall.toml"
MATRICES = "--red HERE/T.npz --green HERE/T.npz --blue HERE/T.npz --camera 9x6 --projector 9x6"
GRAYCODE = f"--projector {PROJECTOR[1]}x{PROJECTOR[0]}"
COMMANDS = {
    "relight.png": "tools.relight ROOM -o OUT/o.png",
    "relight.exr": "tools.relight ROOM -o OUT/o.exr",
    "compensate": "tools.compensate_image ROOM PICTURE --solver map -o OUT/o.png",
    "merge": "tools.merge_exposures SHOTS --times 1 2 4 8 --response linear -o OUT/o.exr",
    "fit": "tools.fit_projector_response HERE/ramp.csv -o OUT/r.toml",
    "build": "tools.build_correction_map OUT/room --regularize 0.2",
    "simulate": "tools.simulate_transport SCENE -o OUT/made --camera 24x18 --projector 20x15",
    "acquire": "tools.acquire_transport --camera simulated:ROOM --scheme graycode --no-preflight -o OUT/made",
    "import": f"tools.import_transport {MATRICES} -o OUT/made",
    "import-graycode": f"tools.import_graycode HERE/captures {GRAYCODE} -o OUT/made",
    "import-pairs": "tools.import_pairs HERE/pairs/pictures HERE/pairs/photographs --camera 48x36 -o OUT/made",
    "join": "tools.join_projectors ROOM ROOM -o OUT/made",
    "play.png": "app ROOM CLIP --frames 2 --output OUT/o.png",
    "play.exr": "app ROOM CLIP --frames 2 --output OUT/o.exr",
    "play.mp4": "app ROOM CLIP --frames 8 --output OUT/o.mp4",
    "play.webm": "app ROOM CLIP --frames 8 --output OUT/o.webm",
    "play.mkv": "app ROOM CLIP --frames 8 --output OUT/o.mkv",
    "play%d.png": "app ROOM CLIP --frames 8 --output OUT/f%02d.png",
}
PAGE = 4096  # allocation unit of a tmpfs
OLD = "o.png", "o.exr", "o.mp4", "o.webm", "o.mkv", "r.toml", "s.json", "f00.png", "f01.png"


def write_inputs(room: Path) -> None:
    """Write a room with its maps, and the other inputs of the commands."""
    here, rng = room.parent, np.random.default_rng(4)
    write_blurred_room(room, np.random.default_rng(3))
    assert build_correction_map.main([str(room), "--regularize", "0.1"]) == 0
    cv2.imwrite(str(here / "picture.png"), rng.integers(0, 256, (30, 40, 3), np.uint8))
    write_bracket(here / "shots", random_scene(rng, (48, 64, 3)), [1, 2, 4, 8], CURVES["linear"])
    (here / "ramp.csv").write_text("level,grey\n" + "".join(f"{level},{level}\n" for level in range(0, 256, 17)))
    sparse.save_npz(here / "T.npz", sparse.csr_array(sparse.eye_array(54, dtype=np.float32)))
    write_opencv_captures(here / "captures", make_rig(rng))
    write_pairs(here / "pairs", Wall(), rng, 8)


def words_of(command: str, out: Path, room: Path) -> tuple[str, list[list[str]]]:
    """Return function and arguments of a command, for tests.faults.Runner."""
    here = room.parent
    names = {"ROOM": room, "CLIP": CLIP, "SCENE": SCENE, "PICTURE": here / "picture.png", "OUT": out, "HERE": here}
    shots = [str(here / "shots" / f"shot{i:02}.png") for i in range(4)]
    module, *words = command.split()
    arguments = [part for word in words for part in (shots if word == "SHOTS" else [_named(word, names)])]
    return f"counterlight.{module}:main", [arguments]


def _named(word: str, names: dict[str, Path]) -> str:
    for name, path in names.items():
        word = word.replace(name, str(path))
    return word


def furnish(out: Path, room: Path) -> dict[str, bytes]:
    """Create an output of every kind, and the folders that the command extends."""
    for name in OLD:
        (out / name).write_text(f"old {name}")
    shutil.copytree(room, out / "room")
    return contents(out)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def room_for(files: Mapping[str, bytes]) -> int:
    """Return the bytes of the pages that files fill."""
    return sum(-(-len(content) // PAGE) * PAGE for content in files.values())


def is_whole(folder: Path, name: str) -> bool:
    """Return whether a file that an interrupted acquisition may leave is complete: a capture, session or room."""
    path = folder / name
    if name.startswith("made.captures/captures/"):
        return read_picture(path).size > 0
    if name.startswith("made/"):
        return bool(calibration.read(folder / "made").calibration.name)
    return name == "made.captures/session.toml" and read_toml(path, "") != {}


def screenshot(folder: str, seed: int) -> str:
    """Save a screenshot in a session with stand-ins; return its path."""
    stage = Stage(screenshots=Path(folder))
    picture = np.random.default_rng(seed).integers(0, 256, (30, 40, 3), np.uint8)
    stage.screen.encoded = lambda: picture  # type: ignore[attr-defined]
    stage.advance(0.1)
    return str(stage.commands.run("screenshot"))
