"""A room of two projectors and two cameras is watched: the device that changes is the one that is named."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from counterlight import calibration
from counterlight.calibration import StoredCalibration
from counterlight.pipeline.drift import Moved
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, simulated_rooms
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.transport.storage import read_transport
from counterlight.tools.watching.cameras import SimulatedFrames
from counterlight.tools.watching.view import RoomView
from counterlight.tools.watching.watcher import Watcher
from counterlight.unattended.watch_link import Answer, Light, Picture
from tests.camera_rooms import write_pairs
from tests.drifted_rooms import write_changed
from tests.oracles.formulas import grid_means
from tests.programs import here

CHANGE_S, END_S, EVERY_S = 3.0, 14.0, 0.5
NEAR_PX, NEAR_LIGHT = 0.06, 0.02  # a film of 11 s after the change; moved boxes of light brighten edges
SENSOR = Sensor(bits=8, full_well=20_000)


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> StoredCalibration:
    folder = tmp_path_factory.mktemp("joint")
    here("join", *write_pairs(folder, gain=(0.9, 1.0, 1.2)), "--cameras", "-o", folder / "room")
    return calibration.read(folder / "room")


def camera_of(stored: StoredCalibration, folder: Path) -> SimulatedFrames:
    first, *others = simulated_rooms(folder)
    settings = CameraSettings(SENSOR, response=stored.calibration.camera.response)
    return SimulatedFrames(stored.calibration, SimulatedCamera(first, settings, None, others), 1)


def watched(stored: StoredCalibration, now: Path, repeats: int | None = None) -> Answer:
    """Return the last answer of a film of random patches; the room changes to `now`.

    repeats : camera that repeats its capture from the change on.
    """
    room = stored.calibration
    watcher = Watcher(RoomView(tier_of(room, read_transport(stored)), 1), 1e-4, 1 / 60, follows=True)
    cameras, rng = [camera_of(stored, folder) for folder in (stored.folder, now)], np.random.default_rng(0)
    height, width = room.projector.shape
    held = None
    for time_s in np.arange(0, END_S, EVERY_S):
        camera = cameras[int(time_s >= CHANGE_S)]
        patches = rng.random((height // 8 + 1, width // 8 + 1, 3)).repeat(8, axis=0).repeat(8, axis=1)
        picture = Picture(float(time_s), patches[:height, :width].astype(np.float16))
        watcher.light(Light(picture.time_s, grid_means(picture.drive)))
        watcher.picture(picture)
        camera.show(picture)
        arrived_s, shot = camera.arrival(), camera.shot()
        if repeats is not None:
            held = shot if time_s < CHANGE_S else held
            shot[room.views[repeats]] = held[room.views[repeats]]
        watcher.capture(arrived_s, shot, camera.exposures)
        answer = watcher.answer(arrived_s)
    return answer


def middles(stored: StoredCalibration, answer: Answer) -> list[np.ndarray]:
    """Return the displacement of the middle of each projector's picture, projector pixels."""
    pairs = zip(answer.projectors, stored.calibration.projectors, strict=True)
    return [Moved(np.array(each.to_raster), np.array(each.gain)).at_corners(device)[0] for each, device in pairs]


@pytest.mark.parametrize(
    ("changes", "moves", "gains"),
    [
        ({"shifts": [(0.5, -0.25), (0, 0)]}, [(0.5, -0.25), (0, 0)], [1, 1]),
        ({"shifts": [(0, 0), (2.0, 1.0)]}, [(0, 0), (2.0, 1.0)], [1, 1]),
        ({"lamps": [0.9, 1.0]}, [(0, 0), (0, 0)], [0.9, 1]),
    ],
)
def test_the_projector_that_changes_is_corrected(
    stored: StoredCalibration, tmp_path: Path, changes: dict[str, Any], moves: list[Any], gains: list[float]
) -> None:
    write_changed(tmp_path / "now", stored, **changes)
    answer = watched(stored, tmp_path / "now")
    np.testing.assert_allclose(middles(stored, answer), moves, atol=NEAR_PX)
    for found, gain in zip(answer.projectors, gains, strict=True):
        np.testing.assert_allclose(found.gain, gain, atol=NEAR_LIGHT)


@pytest.mark.parametrize("moved", [0, 1])
def test_the_camera_that_moves_is_named_and_nothing_is_corrected(
    stored: StoredCalibration, tmp_path: Path, moved: int
) -> None:
    cameras = [(1, 1) if number == moved else (0, 0) for number in range(2)]
    write_changed(tmp_path / "now", stored, cameras=cameras)
    answer = watched(stored, tmp_path / "now")
    assert (answer.state, answer.reason.split(" has")[0]) == ("camera moved", f"camera {moved + 1}")
    assert np.abs(middles(stored, answer)).max() < NEAR_PX


@pytest.mark.parametrize("repeats", [0, 1])
def test_the_camera_that_repeats_its_picture_is_named(stored: StoredCalibration, repeats: int) -> None:
    answer = watched(stored, stored.folder, repeats)
    assert (answer.state, answer.reason) == (
        "no camera",
        f"camera {repeats + 1} repeats one picture while the film changes",
    )
    assert np.abs(middles(stored, answer)).max() < NEAR_PX
