"""Rooms and media that several tests of windows use."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from tests.joint_rooms import join, write_halves
from tests.programs import here
from tests.rooms import write_blurred_room
from tests.web_remote import Place, Visitor, show_with_remote

AT_START = {"pause": False, "blackout": False, "test-card": "no", "view": "projector", "loop-file": True}


@pytest.fixture(scope="module")
def small_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a room with projector 36x28 and camera 40x30, one per module, because a placement is saved in the room."""
    folder = tmp_path_factory.mktemp("small") / "wall"
    write_blurred_room(folder, np.random.default_rng(7), (30, 40), (28, 36))
    here("build", folder, "--regularize", "0.1")
    return folder


@pytest.fixture(scope="session")
def plain_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a room with projector 100x75 and camera 120x90, without the maps of refinement."""
    folder = tmp_path_factory.mktemp("plain") / "wall"
    write_blurred_room(folder, np.random.default_rng(7), (90, 120), (75, 100))
    here("build", folder, "--regularize", "0.1", "--no-refine")
    return folder


@pytest.fixture(scope="session")
def joint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a room with two projectors (tests/joint_rooms.py)."""
    folder = tmp_path_factory.mktemp("joint")
    room = join(write_halves(folder), folder / "joint")
    here("build", room, "--regularize", "0.1")
    return room


@pytest.fixture
def noise_picture(tmp_path: Path, rng: np.random.Generator) -> Path:
    """Write a noise picture of the size of plain_room's projector."""
    path = tmp_path / "picture.png"
    cv2.imwrite(str(path), rng.integers(0, 255, (75, 100, 3), np.uint8))
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return the player's working folder, with a small clip of five seconds."""
    write_clip(tmp_path)
    return tmp_path


def write_clip(folder: Path) -> None:
    with av.open(str(folder / "clip.mkv"), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for index in range(125):
            picture = np.full((48, 64, 3), index, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))


@pytest.fixture(scope="module")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the working folder of the shared show."""
    folder = tmp_path_factory.mktemp("shared")
    write_clip(folder)
    return folder


@pytest.fixture(scope="module")
def shared_show(xvfb: str, small_room: Path, shared_folder: Path) -> Iterator[tuple[Any, Place]]:
    """Process and page of a looping show that several tests use."""
    with show_with_remote(xvfb, shared_folder, small_room, "clip.mkv", "--loop") as shown:
        yield shown


@pytest.fixture
def visitor(shared_show: tuple[Any, Place]) -> Iterator[Visitor]:
    """Visitor of the shared show, which plays as at its start, and is paused between tests to leave the cores alone."""
    with shared_show[1].visit() as visitor:
        for name, value in AT_START.items():
            assert visitor.ask("set_property", name, value)["error"] == "success"
        assert visitor.ask("loadfile", "clip.mkv")["error"] == "success"
        yield visitor
        visitor.ask("set_property", "pause", True)
