"""Captures belong to one acquisition: only this acquisition resumes with them, until its room is in place."""

import filecmp
import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.tools import acquire_transport
from counterlight.tools.acquisition.cameras.camera import Exposures
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, simulated_rooms
from counterlight.tools.acquisition.linearity import SHOTS
from counterlight.tools.acquisition.plan import REPEATS
from counterlight.tools.acquisition.ramps import light_level
from counterlight.tools.acquisition.store import SESSION, Wanted, open_store
from counterlight.tools.transport.storage import read_transport
from tests.acquired_rooms import CAMERA, PROJECTOR, shown_by
from tests.faults import Fault, Runner
from tests.rooms import write_blurred_room

# Black and floodlight, a picture and its complement, ramps and primaries, Gray code of 30x21, floodlight and checks.
PICTURES = 2 * REPEATS + 2 * SHOTS + len(light_level(PROJECTOR).patterns) + 2 * (5 + 5) + 3


@pytest.fixture(scope="module")
def runner() -> Iterator[Runner]:
    with Runner() as runner:
        yield runner


def redecorate(room: Path, seed: int) -> None:
    """Replace the simulated room by another room of the same name and size."""
    shutil.rmtree(room, ignore_errors=True)
    write_blurred_room(room, np.random.default_rng(seed), CAMERA, PROJECTOR)


def arguments_of(room: Path, output: Path) -> list[str]:
    words = ["--camera", f"simulated:{room}", "--scheme", "graycode", "--no-preflight", "--name", "twin"]
    return [*words, "-o", str(output)]


def same_folders(one: Path, other: Path) -> bool:
    names = sorted(path.name for path in one.iterdir())
    assert names == sorted(path.name for path in other.iterdir())
    return filecmp.cmpfiles(one, other, names, shallow=False) == (names, [], [])


def captures(output: Path) -> Path:
    """Returns the folder of a finished acquisition's captures, and checks that there are no others."""
    folder = output.with_name(f"{output.name}.captures")
    (found,) = (path for path in folder.iterdir() if path.is_dir())
    assert sorted(path.name for path in folder.iterdir()) == [found.name, "session.toml"]
    return found


def refused(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    capsys.readouterr()
    assert acquire_transport.main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_force_takes_new_captures_of_a_room_that_has_changed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room, output = tmp_path / "room", tmp_path / "out"
    for seed, force in ((1, []), (2, ["--force"]), (3, ["--force"])):
        redecorate(room, seed)
        assert acquire_transport.main([*arguments_of(room, output), *force]) == 0
        assert "from before" not in capsys.readouterr().out
        fresh = tmp_path / f"fresh_{seed}"
        assert acquire_transport.main(arguments_of(room, fresh)) == 0
        assert same_folders(output, fresh)
        assert same_folders(captures(output), captures(fresh))


def test_old_captures_are_used_again_only_by_who_asks_for_that(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room, output = tmp_path / "room", tmp_path / "out"
    redecorate(room, 1)
    assert acquire_transport.main(arguments_of(room, output)) == 0
    shutil.copytree(output, tmp_path / "first")
    assert "--reuse-captures" not in refused(capsys, arguments_of(room, output))  # a calibration exists already
    shutil.rmtree(output)
    line = refused(capsys, arguments_of(room, output))
    assert "out.captures: captures of an acquisition that is finished; take new ones with --force" in line
    for force in ([], ["--force"]):
        shutil.rmtree(output, ignore_errors=True)
        assert acquire_transport.main([*arguments_of(room, output), "--reuse-captures", *force]) == 0
        assert f"{PICTURES} of them from before" in capsys.readouterr().out
        assert same_folders(output, tmp_path / "first")
    nowhere = [*arguments_of(room, tmp_path / "other"), "--reuse-captures"]
    assert "holds no captures to use again" in refused(capsys, nowhere)


def test_killed_at_any_step_the_rooms_are_whole_and_the_next_run_ends_the_same(tmp_path: Path, runner: Runner) -> None:
    """A forced acquisition over a finished one survives kills, most of them at the end, where rooms are exchanged.

    `make fuzz` kills at thousands of steps.
    """
    room, output = tmp_path / "room", tmp_path / "out"
    redecorate(room, 1)
    assert acquire_transport.main(arguments_of(room, output)) == 0
    old = calibration.read(output).fingerprint
    for name in ("out", "out.captures", "out.report"):
        shutil.copytree(tmp_path / name, tmp_path / "kept" / name)
    redecorate(room, 2)
    fresh = tmp_path / "fresh"
    assert acquire_transport.main(arguments_of(room, fresh)) == 0
    new = calibration.read(fresh).fingerprint
    command = "counterlight.tools.acquire_transport:main", [[*arguments_of(room, output), "--force"]]
    steps = runner.run(*command).steps
    found = []
    for at in (*range(1, steps - 160, 600), *range(steps - 160, steps + 1, 40)):
        for name in ("out", "out.captures", "out.report"):
            shutil.rmtree(tmp_path / name)
            shutil.copytree(tmp_path / "kept" / name, tmp_path / name)
        assert runner.run(*command, Fault(at)).code == -9
        found.append(calibration.read(output).fingerprint)
        read_transport(calibration.read(output))
        done = runner.run(*command)
        assert done.code == 0, done.words
        assert same_folders(output, fresh)
        assert same_folders(captures(output), captures(fresh))
        assert [path.name for path in tmp_path.glob(".*")] == []
    assert set(found) == {old, new}
    assert found == sorted(found, key=[old, new].index)


def test_interrupted_after_a_finished_one_it_goes_on_with_its_own(
    tmp_path: Path, runner: Runner, capsys: pytest.CaptureFixture[str]
) -> None:
    room, output = tmp_path / "room", tmp_path / "out"
    redecorate(room, 1)
    assert acquire_transport.main(arguments_of(room, output)) == 0
    redecorate(room, 2)
    command = [*arguments_of(room, output), "--force"]
    steps = runner.run("counterlight.tools.acquire_transport:main", [command]).steps
    redecorate(room, 3)
    run = runner.run("counterlight.tools.acquire_transport:main", [command], Fault(steps // 3))
    assert run.code == -9
    taken = len(list((tmp_path / "out.captures" / "captures").glob("0*.png")))
    assert 3 < taken < PICTURES
    capsys.readouterr()
    assert acquire_transport.main(command) == 0
    assert f"{taken} of them from before" in capsys.readouterr().out


def test_one_acquisition_at_a_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    room, output = tmp_path / "room", tmp_path / "out"
    redecorate(room, 1)
    camera = SimulatedCamera(simulated_rooms(room)[0], CameraSettings())
    with open_store(tmp_path / "out.captures", {}, camera.exposures, Wanted(output)):
        assert "out.captures: process" in refused(capsys, arguments_of(room, output))
    assert not output.exists()


def test_a_folder_camera_does_not_take_yesterdays_captures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    room, exchange = tmp_path / "room", tmp_path / "exchange"
    redecorate(room, 1)
    eye = SimulatedCamera(simulated_rooms(room)[0], CameraSettings())
    camera = ["--camera", f"folder:{exchange}", "--projector", "30x21", "--scheme", "graycode"]
    camera += ["--exposures", str(eye.exposures.times[0])]
    command = [*camera, "-o", str(tmp_path / "out")]
    photograph(command, exchange, eye)
    assert acquire_transport.main(command) == 0
    for again in ([*command, "--force"], [*camera, "-o", str(tmp_path / "other")]):
        assert "exchange/captures: holds captures of another acquisition; move them away" in refused(capsys, again)
        assert "exchange/captures: holds captures of another acquisition; move them away" in refused(capsys, again)
    (exchange / "captures").rename(tmp_path / "yesterday")
    redecorate(room, 2)
    photograph([*command, "--force"], exchange, SimulatedCamera(simulated_rooms(room)[0], CameraSettings()))
    assert acquire_transport.main([*command, "--force"]) == 0
    truth = read_transport(calibration.read(room)).composition()
    found = read_transport(calibration.read(tmp_path / "out")).composition()
    # noise is below 1 %, and the light of another room would differ by much more
    assert np.corrcoef(truth.ravel(), found.ravel())[0, 1] > 0.99


def photograph(command: list[str], exchange: Path, eye: SimulatedCamera) -> None:
    """Photograph the patterns that the command shows, until its last level is captured."""
    while acquire_transport.main(command) != 0:
        shown = sorted((exchange / "patterns").glob("*.png"))
        for path in shown:
            capture = exchange / "captures" / path.name
            if not capture.exists():
                (shot,) = eye.capture(int(path.stem), shown_by(path))
                cv2.imwrite(str(capture), shot[..., ::-1])
        if len(shown) == PICTURES:
            return


@pytest.mark.parametrize("value", ["2", "true", "3.0", f'"{"x" * 5000}"'])
def test_a_session_of_another_format_is_refused_in_a_short_line(value: str, tmp_path: Path) -> None:
    (tmp_path / SESSION).write_text(f'format = {value}\nid = "a"\ncaptures = "captures"\n')
    with (
        pytest.raises(InputError, match=r"session\.toml: format .*, this version reads 5; name another") as caught,
        open_store(tmp_path, {}, Exposures((0.1,)), Wanted(tmp_path.with_name("room"))),
    ):
        pass
    assert len(str(caught.value)) < 400
