"""build --method thesis: near and far light in one T, cut, energy fitted, plain pseudo-inverse, clamp (thesis 4.2.2 to 5.1)."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from counterlight import calibration
from counterlight import memory as installed
from counterlight.errors import InputError
from counterlight.pipeline.room import read_room
from counterlight.tools.build_correction_map import main as build
from counterlight.tools.clusters.components import find_clusters
from counterlight.tools.clusters.decomposition import Parameters, decompose
from counterlight.tools.inverse.inverse import InverseOptions
from counterlight.tools.inverse.room import build_maps, build_room_maps
from counterlight.tools.simulation.room import simulated_calibration
from counterlight.tools.simulation.scene import load_scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.study.rooms import Task, open_room
from counterlight.tools.study.pictures import find_pictures
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import channels, in_one, luminance_matrix
from tests.programs import fail, succeed
from tests.scenes import SCENES

CAMERA, PROJECTOR = (18, 32), (14, 25)
GIVEN = Parameters(3, 0.6, 0.9)


@pytest.fixture(scope="module")
def corner(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A room with far light."""
    folder = tmp_path_factory.mktemp("thesis")
    scene = (SCENES / "corner.toml").read_text().replace("cells = 700", "cells = 100")
    (folder / "corner.toml").write_text(scene)
    result = simulate(load_scene(folder / "corner.toml").resized(CAMERA, PROJECTOR))
    with calibration.writing(
        folder / "corner", simulated_calibration(load_scene(folder / "corner.toml").resized(CAMERA, PROJECTOR), result)
    ) as stage:
        write_transport(result.transport, stage)
    return folder / "corner"
