"""Rooms that several tests of windows play in, built once."""

from pathlib import Path

import numpy as np
import pytest

from tests.joint_rooms import join, write_halves
from tests.programs import succeed
from tests.rooms import write_blurred_room


@pytest.fixture(scope="session")
def plain_room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Projector 100x75, camera 120x90, without the maps of refinement."""
    folder = tmp_path_factory.mktemp("plain") / "wall"
    write_blurred_room(folder, np.random.default_rng(7), (90, 120), (75, 100))
    succeed("build-correction-map", folder, "--regularize", "0.1", "--no-refine")
    return folder


@pytest.fixture(scope="session")
def joint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two projectors (tests/joint_rooms.py)."""
    folder = tmp_path_factory.mktemp("joint")
    room = join(write_halves(folder), folder / "joint")
    succeed("build-correction-map", room, "--regularize", "0.1")
    return room
