"""A camera watches a running show: the watcher of the product finds a moved picture, and the player corrects it."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.tools.watching.record import report
from tests.drifted_rooms import write_changed
from tests.programs import wait_until
from tests.remote import on_any_machine, show
from tests.rig.films import RATE, Film

# The changed room moves pixels as boxes of light: a part of a pixel would blur the picture and move its corners by 0.3.
MOVED_PX, TOLERANCE_PX = (1.0, -1.0), 0.05


@pytest.mark.parametrize("name", ["plain_room", "joint"])
def test_a_drift_is_found_in_the_film_and_corrected(
    xvfb: str, name: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """The last projector drifts. The second room has two projectors, each with its own window."""
    room = shutil.copytree(request.getfixturevalue(name), tmp_path / "room")
    stored, rng = calibration.read(room), np.random.default_rng(5)
    still = [(0.0, 0.0)] * (len(stored.calibration.regions) - 1)
    write_changed(tmp_path / "now", stored, shifts=[*still, MOVED_PX])
    scenes = [cv2.GaussianBlur(rng.uniform(-600, 855, (90, 120, 3)), (0, 0), 1.5) for _ in range(4)]
    frames = np.repeat(np.clip(scenes, 0, 255).astype(np.uint8), RATE, axis=0)
    film = Film("scenes", frames).write(tmp_path / "film.mkv")
    words = "--loop", "--osd", "off", "--watch", f"simulated:{tmp_path / 'now'}", "--white", "0.5"
    words = *words, "--watch-record", tmp_path / "record"
    with show(xvfb, tmp_path, room, film, *words) as (process, client):

        def found() -> bool:
            return abs((client.get("watch-state").get("moved_px") or 0.0) - max(MOVED_PX)) < TOLERANCE_PX

        wait_until(found, "the drift", process)
        wait_until(lambda: client.get("watch-state")["state"] in ("correcting", "holding"), "the correction", process)
        assert client.ask("set_property", "watch-freeze", True)["error"] == "success"
        wait_until(lambda: client.get("watch-state")["state"] == "frozen", "the freeze", process)
        wait_until(lambda: any((tmp_path / "record").glob("*-blocks.png")), "the recorded blocks", process)
        assert on_any_machine(client.get("notices")) == []
    assert any("correcting" in line or "holding" in line for line in report(tmp_path / "record"))
