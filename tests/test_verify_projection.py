"""counterlight verify: the closed loop in a simulated room, the report of an acquisition, and rooms that are others."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.tools import acquire_transport, verify_projection
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, simulated_room
from counterlight.tools.inverse.pictures import typical_pictures
from tests.acquired_rooms import shown_by
from tests.rooms import write_blurred_room
from tests.test_acquisition import CAMERA, PROJECTOR


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with room/, the truth, acquired/, what was acquired of it with few noisy captures, and picture.png."""
    folder = tmp_path_factory.mktemp("rooms")
    write_blurred_room(folder / "room", np.random.default_rng(8), CAMERA, PROJECTOR)
    words = ["--camera", f"simulated:{folder / 'room'}", "--scheme", "multiplexed", "--full-well", "2000"]
    assert acquire_transport.main([*words, "-o", str(folder / "acquired")]) == 0
    picture = cv2.resize(typical_pictures((6, 8))[0], CAMERA[::-1]).clip(0, 1)
    cv2.imwrite(str(folder / "picture.png"), np.round(255 * picture[..., None].repeat(3, 2) ** 0.45))
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
    assert measured[0] < predicted[0]  # T knows nothing of its own errors
    assert measured[1:].max() > measured[0] + 0.1  # dB
    assert model.min() > 25
    assert {path.name for path in out.iterdir()} == {
        f"{n}.png" for n in ("projected", "desired", "predicted", "captured")
    }
    assert cv2.imread(str(out / "projected.png")).shape == (*PROJECTOR, 3)


def test_another_room_is_noticed(rooms: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_blurred_room(tmp_path / "other", np.random.default_rng(9), CAMERA, PROJECTOR)
    assert verify_projection.main([*verified(rooms)[:3], f"simulated:{tmp_path / 'other'}"]) == 2
    assert re.search(
        r"the floodlit room now differs by .* moved; put them back, or acquire again", capsys.readouterr().err
    )
    write_blurred_room(tmp_path / "large", np.random.default_rng(9), CAMERA, (12, 16))
    assert verify_projection.main([*verified(rooms)[:3], f"simulated:{tmp_path / 'large'}"]) == 2
    assert "the projector has 16x12 pixels, " in capsys.readouterr().err
    assert verify_projection.main([*verified(rooms)[:3], f"folder:{tmp_path}", "--projector", "21x30"]) == 2
    assert "the projector has 21x30 pixels, " in (line := capsys.readouterr().err)
    assert "is for 30x21; width and height are swapped" in line


def test_a_folder_is_asked_round_by_round_and_ends_as_the_camera_itself(
    rooms: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = ["--rounds", "1", "--repeats", "2"]
    assert verify_projection.main(verified(rooms, "--no-preflight", *more)) == 0
    direct = capsys.readouterr().out
    eye = SimulatedCamera(simulated_room(rooms / "room"), CameraSettings())
    exchange, asked = tmp_path / "exchange", 0
    words = [*verified(rooms)[:3], f"folder:{exchange}", "--projector", "30x21", *more]
    words += ["--exposures", repr(eye.exposures.times[0])]
    while verify_projection.main(words) != 0:
        assert "waiting for " in capsys.readouterr().err
        asked += 1
        for path in sorted((exchange / "patterns").glob("*.png")):
            if not (exchange / "captures" / path.name).exists():
                (shot,) = eye.capture(int(path.stem), shown_by(path))
                cv2.imwrite(str(exchange / "captures" / path.name), shot[..., ::-1])
    assert asked == 1 + 2  # black and white, the picture, one round of feedback
    assert capsys.readouterr().out.endswith(direct)
    assert verify_projection.main([*words, "--solver", "box", "--repeats", "3"]) == 2
    assert "holds captures of another acquisition; move them away" in capsys.readouterr().err


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
    assert [finding["grade"] for finding in figures["preflight"]] == ["good"] * 9
    room = calibration.read(rooms / "acquired").calibration
    assert figures["lit_camera_pixels"] == room.mask.sum()
    for promised in figures["predicted_psnr"].values():
        assert promised["with_check_error"] < promised["by_transport"]
    floodlight = cv2.imread(str(folder / "floodlight.png"))
    assert floodlight.shape == (*CAMERA, 3)
