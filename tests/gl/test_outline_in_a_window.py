"""Placing in a real window: outline and handle of the selected corner are on the screen, not in saved pictures."""

from pathlib import Path

import cv2
import numpy as np

from counterlight.overlay.outline import SELECTED
from tests.desktop import expected_picture, screen
from tests.joint_rooms import SIDE_BY_SIDE
from tests.programs import PATIENCE_S, wait_until
from tests.remote import show

BOX = (0, 0, 100, 75)


def test_the_outline_comes_and_goes(xvfb: str, plain_room: Path, noise_picture: Path, tmp_path: Path) -> None:
    expected = expected_picture(plain_room, noise_picture, tmp_path)

    def handle() -> bool:
        return bool((screen(xvfb, BOX) == SELECTED[:3]).all(axis=2).any())

    def plain() -> bool:
        return np.array_equal(screen(xvfb, BOX), expected)

    with show(xvfb, tmp_path, plain_room, noise_picture) as (process, client):
        wait_until(plain, "the picture", process)
        for view in ("projector", "camera"):
            assert client.ask("place")["error"] == "success"
            for _ in range(3):  # a region below the text
                assert client.ask("place-corner")["error"] == "success"
            assert client.ask("set_property", "view", view)["error"] == "success"
            wait_until(handle, "the handle of the lower right corner", process)
            saved = cv2.imread(str(tmp_path / client.ask("screenshot")["data"]))[..., ::-1]
            assert not (saved == SELECTED[:3]).all(axis=2).any()
            assert client.ask("set_property", "view", "projector")["error"] == "success"
            assert client.ask("place-cancel")["error"] == "success"
            wait_until(plain, "the picture without it", process)
        client.ask("quit")
        assert process.wait(PATIENCE_S) == 0


def test_it_runs_through_the_windows_of_several_projectors(
    xvfb: str,
    joint: Path,
    noise_picture: Path,
    tmp_path: Path,
) -> None:
    """Only the first window has the text. The second window shows only its part of the outline."""
    second = SIDE_BY_SIDE[1]

    def handles() -> bool:
        return bool((screen(xvfb, second) == SELECTED[:3]).all(axis=2).any())

    with show(xvfb, tmp_path, joint, noise_picture) as (process, client):
        client.ask("place")
        wait_until(handles, "handles in the second window", process)
        client.ask("set_property", "view", "camera")  # the first window shows the complete outline
        wait_until(lambda: screen(xvfb, second).max() == 0, "black in the second window", process)
        client.ask("set_property", "view", "projector")
        wait_until(handles, "handles in the second window again", process)
        client.ask("place-cancel")
        wait_until(lambda: not handles(), "the picture without them", process)
        client.ask("quit")
        assert process.wait(PATIENCE_S) == 0
