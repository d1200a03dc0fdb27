"""counterlight import-graycode as a user runs it: the folder that it writes, its summary, refusals in one line."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.response import Response
from counterlight.tools.import_graycode import main
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.transport.transport import channel
from tests.programs import refusal_here
from tests.test_graycode import PROJECTOR, make_rig, real_sets, write_named_captures, write_opencv_captures

SIZE = f"{PROJECTOR[1]}x{PROJECTOR[0]}"


@pytest.fixture
def captures(rng: np.random.Generator, tmp_path: Path) -> Path:
    write_opencv_captures(tmp_path / "captures", make_rig(rng))
    return tmp_path / "captures"


def refusal(capsys: pytest.CaptureFixture[str], folder: Path, *arguments: str) -> str:
    """Returns the only line that a refused import prints; checks that it leaves no files."""
    return refusal_here(main, capsys, folder.parent, *arguments, "-o", folder)


def test_the_command_makes_a_calibration(captures: Path, tmp_path: Path) -> None:
    """T·1 + e is the captured white inside the mask, and e is the captured black everywhere."""
    folder = tmp_path / "room"
    arguments = [
        str(captures),
        "--projector",
        SIZE,
        "--response",
        "2.2",
        "--camera-response",
        "srgb",
        "-o",
        str(folder),
    ]
    command = [sys.executable, "-m", "counterlight", "import-graycode", *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert re.search(r"opencv order, camera taken as srgb: \d+ of 127x95 camera pixels valid", ended.stdout)
    assert re.search(
        r"projector pixels: \d+ seen, \d+ filled, \d+ never seen;.* \d+\.\d s\n.*: imported; next: ", ended.stdout
    )
    stored = calibration.read(folder)
    room = stored.calibration
    assert (room.name, room.projector.shape) == ("room", PROJECTOR)
    assert room.projector.response == Response("gamma", gamma=2.2)
    assert "captures: opencv order" in room.provenance
    last = len(list(captures.iterdir()))
    white, black = (
        Response("srgb").to_linear(cv2.imread(str(captures / f"shot{last - i}.png"), cv2.IMREAD_GRAYSCALE) / 255.0)
        for i in (2, 1)
    )
    np.testing.assert_allclose(room.ambient, np.repeat(black[..., None], 3, axis=2), rtol=2e-7)  # stored as float32
    composition = read_transport(stored).composition().reshape(*room.camera.shape, 3)
    expected = np.where(room.mask, white - black, 0)
    # white and black are each rounded to float32; near black, their difference keeps an absolute error
    np.testing.assert_allclose(composition, np.repeat(expected[..., None], 3, axis=2), atol=1e-7)
    assert 0.7 < room.mask[20:60, 20:100].mean() <= 1


def test_the_summary_counts_what_was_written(
    captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(captures), "--projector", SIZE, "-o", str(tmp_path / "room")]) == 0
    printed = capsys.readouterr().out
    stored = calibration.read(tmp_path / "room")
    reached = int((channel(read_transport(stored).near, 0).sum(axis=0) > 0).sum())
    valid, seen, filled, never = (
        int(re.search(pattern, printed)[1])  # type: ignore[index]
        for pattern in (r"(\d+) of 127x95", r"(\d+) seen", r"(\d+) filled", r"(\d+) never")
    )
    assert valid == stored.calibration.mask.sum()
    assert (seen + filled, never) == (reached, PROJECTOR[0] * PROJECTOR[1] - reached)


def test_colour_weighs_each_channel(rng: np.random.Generator, tmp_path: Path) -> None:
    rig = make_rig(rng, channels=3, noise=0)
    write_named_captures(tmp_path / "captures", rig, flood=True)
    assert main([str(tmp_path / "captures"), "--projector", SIZE, "-o", str(tmp_path / "room")]) == 0
    stored = calibration.read(tmp_path / "room")
    composition = read_transport(stored).composition().reshape(*stored.calibration.camera.shape, 3)
    pure = rig.pure & stored.calibration.mask
    # white is rounded to whole code values, and black is exactly 10
    np.testing.assert_allclose(composition[pure] * 255, 190 * rig.albedo[pure], atol=0.5 + 1e-4)


def test_what_decodes_but_is_hardly_lit_does_not_count(rng: np.random.Generator, tmp_path: Path) -> None:
    """Ink of albedo 0.035 has a contrast of 6.6 code values, enough to decode, but 3.5 % of the light around it."""
    rig = make_rig(rng, noise=0)
    rig.albedo[30:40, 50:70] = 0.035
    write_opencv_captures(tmp_path / "captures", rig)
    assert main([str(tmp_path / "captures"), "--projector", SIZE, "-o", str(tmp_path / "room")]) == 0
    stored = calibration.read(tmp_path / "room")
    room = stored.calibration
    assert rig.pure[30:40, 50:70].any()
    assert not room.mask[30:40, 50:70].any()
    assert not read_transport(stored).composition().reshape(*room.camera.shape, 3)[30:40, 50:70].any()


def test_a_step_lights_every_pixel_of_a_cell(rng: np.random.Generator, tmp_path: Path) -> None:
    write_named_captures(tmp_path / "captures", make_rig(rng), step=2)
    arguments = [str(tmp_path / "captures"), "--projector", SIZE, "--step", "2", "-o", str(tmp_path / "room")]
    assert main(arguments) == 0
    reached = (
        np.asarray(channel(read_transport(calibration.read(tmp_path / "room")).near, 0).sum(axis=0)).reshape(PROJECTOR)
        > 0
    )
    assert reached[4:22, 8:30].all()


def test_other_pictures_are_left_out_and_counted(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_named_captures(tmp_path / "captures", make_rig(rng))
    cv2.imwrite(str(tmp_path / "captures" / "sine_x.png"), np.zeros((3, 3), np.uint8))
    assert main([str(tmp_path / "captures"), "--projector", SIZE, "-o", str(tmp_path / "room")]) == 0
    assert "1 other pictures left out" in capsys.readouterr().out


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


def shrink(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros((94, 127), np.uint8))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (Path.unlink, r"23 captures, expected 24 for a code of 37x29 in OpenCV's order"),
        (truncate, r"shot7\.png: .*truncated"),
        (shrink, r"shot7\.png: 127x94 grey 8-bit, expected 127x95 grey 8-bit"),
        (lambda path: path.write_bytes(b"no picture"), r"shot7\.png: neither PNG nor JPEG"),
    ],
)
def test_damaged_captures_are_refused(
    captures: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    damage: Callable[[Path], object],
    message: str,
) -> None:
    damage(captures / "shot7.png")
    assert re.search(message, refusal(capsys, tmp_path / "room", str(captures), "--projector", SIZE))


def test_a_superfluous_capture_is_refused(captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (captures / "shot99.png").write_bytes((captures / "shot0.png").read_bytes())
    line = refusal(capsys, tmp_path / "room", str(captures), "--projector", SIZE)
    assert "25 captures, expected 24" in line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--projector", "128x128"], "24 captures, expected 30 for a code of 128x128"),
        (["--projector", "37"], "a size is WIDTHxHEIGHT"),
        (["--projector", SIZE, "--order", "sltk"], "0 captures of axis y, expected 10 for 29 cells"),
        (["--projector", SIZE, "--order", "random"], "invalid choice"),
        (["--projector", SIZE, "--min-contrast", "0"], "--min-contrast 0: expected above 0"),
        (["--projector", SIZE, "--min-contrast", "nan"], "--min-contrast nan: expected above 0"),
        (["--projector", SIZE, "--min-contrast", "254"], "no camera pixel shows a pattern"),
        (["--projector", SIZE, "--step", "0"], "--step 0: expected 1"),
        (["--projector", SIZE, "--fill-radius", "-1"], "--fill-radius -1: expected 0"),
        (["--projector", SIZE, "--camera-response", "film"], "expected linear, srgb, a gamma"),
        (["--projector", SIZE, "--response", "absent.toml"], "absent.toml: missing"),
        ([], "required: --projector"),
    ],
)
def test_wrong_arguments_are_refused(
    captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert message in refusal(capsys, tmp_path / "room", str(captures), *arguments)


def test_missing_and_doubled_named_captures_are_refused(
    rng: np.random.Generator, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "captures"
    write_named_captures(folder, make_rig(rng))
    arguments = str(folder), "--projector", SIZE
    original = folder / "02_x_bit04_pos.png"
    (folder / "99_x_bit04_pos.png").write_bytes(original.read_bytes())
    assert "shows the same pattern as" in refusal(capsys, tmp_path / "room", *arguments)
    (folder / "99_x_bit04_pos.png").unlink()
    original.unlink()
    line = refusal(capsys, tmp_path / "room", *arguments)
    assert "11 captures of axis x, expected 12 for 37 cells; missing: x_bit4_pos" in line


def test_a_dark_room_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "captures").mkdir()
    for i in range(24):
        cv2.imwrite(str(tmp_path / "captures" / f"{i}.png"), np.full((9, 11), 12, np.uint8))
    line = refusal(capsys, tmp_path / "room", str(tmp_path / "captures"), "--projector", SIZE)
    assert "no camera pixel shows a pattern" in line


def test_missing_folders_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = refusal(capsys, tmp_path / "room", str(tmp_path / "absent"), "--projector", SIZE)
    assert "absent: no such folder" in line
    (tmp_path / "empty").mkdir()
    assert "no captures in it" in refusal(capsys, tmp_path / "room", str(tmp_path / "empty"), "--projector", SIZE)


def test_a_calibration_is_replaced_only_with_force(
    captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [str(captures), "--projector", SIZE]
    assert main([*arguments, "-o", str(tmp_path / "room")]) == 0
    capsys.readouterr()
    first = calibration.read(tmp_path / "room").fingerprint
    assert "--force" in refusal(capsys, tmp_path / "room", *arguments)
    assert calibration.read(tmp_path / "room").fingerprint == first
    assert main([*arguments, "--name", "again", "--force", "-o", str(tmp_path / "room")]) == 0
    assert calibration.read(tmp_path / "room").calibration.name == "again"


def test_real_captures_become_calibrations(tmp_path: Path) -> None:
    for number, (captures, (height, width), step, _) in enumerate(real_sets()):
        folder = tmp_path / str(number)
        size = f"{width}x{height}"
        assert main([str(captures), "--projector", size, "--step", str(step), "-o", str(folder)]) == 0
        stored = calibration.read(folder)
        composition = read_transport(stored).composition()
        assert stored.calibration.mask.sum() > 100_000
        np.testing.assert_array_equal(composition.any(axis=1), stored.calibration.mask.ravel())
        assert composition.max() <= 1
