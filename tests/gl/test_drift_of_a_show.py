"""A camera checks a running show: the player adopts the correction without a gap."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from counterlight import calibration
from counterlight.tools import verify_projection
from tests.desktop import expected_picture, screen
from tests.drifted_rooms import write_changed
from tests.programs import wait_until
from tests.remote import show

BOX = (0, 0, 100, 75)


def test_a_check_beside_a_show_is_taken_over(
    xvfb: str, plain_room: Path, noise_picture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room = shutil.copytree(plain_room, tmp_path / "room")
    before = expected_picture(room, noise_picture, tmp_path)
    write_changed(tmp_path / "now", calibration.read(room), shift=(0.8, -0.6))
    beats = tmp_path / "beats"

    def known_drift() -> Any:
        return json.loads(beats.read_text().splitlines()[-1])["drift"]

    with show(xvfb, tmp_path, room, noise_picture, "--osd", "off", "--heartbeat", beats) as (process, client):
        wait_until(lambda: np.array_equal(screen(xvfb, BOX), before), "the picture", process)
        assert known_drift() is None
        camera = ["--camera", f"simulated:{tmp_path / 'now'}", "--control", str(tmp_path / "show.socket")]
        assert verify_projection.main([str(room), *camera]) == 0
        after = expected_picture(room, noise_picture, tmp_path)
        assert np.abs(after - before).max() > 20  # in code values: the noise picture has moved
        wait_until(lambda: np.array_equal(screen(xvfb, BOX), after), "the corrected picture", process)
        assert client.get("pause") is False  # playback has resumed
        wait_until(lambda: known_drift() is not None, "a beat", process)
        np.testing.assert_allclose(known_drift()["moved"], [[0.8, -0.6]], atol=0.05)  # boxes of light, noise
    capsys.readouterr()
    assert verify_projection.main([str(room), *camera]) == 2
    assert "show.socket: no answer" in capsys.readouterr().err


def test_a_show_looks_at_its_room_by_itself(xvfb: str, plain_room: Path, noise_picture: Path, tmp_path: Path) -> None:
    room = shutil.copytree(plain_room, tmp_path / "room")
    before = expected_picture(room, noise_picture, tmp_path)
    write_changed(tmp_path / "now", calibration.read(room), shift=(0.8, -0.6))
    options = "--check-every", "0.05", "--check-with", f"--camera 'simulated:{tmp_path / 'now'}'"
    with show(xvfb, tmp_path, room, noise_picture, "--osd", "off", *options) as (process, client):
        wait_until((room / "drift" / "drift.toml").exists, "a check", process)
        after = expected_picture(room, noise_picture, tmp_path)
        assert np.abs(after - before).max() > 20  # in code values: the noise picture has moved
        wait_until(lambda: np.array_equal(screen(xvfb, BOX), after), "the corrected picture", process)
        wait_until(lambda: client.get("pause") is False, "the show to go on", process)
