"""Rooms of one camera and two overlapping projectors of different sizes, so that a wrong offset shows."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import sparse

from counterlight.calibration import Calibration, Device, writing
from counterlight.response import Response
from counterlight.tools.joining.projectors import join_transports
from counterlight.tools.simulation.room import simulated_calibration
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Transport
from tests.programs import here
from tests.rooms import blurred_transport

CAMERA = (33, 60)
LEFT, RIGHT = (30, 44), (26, 36)
SIDE_BY_SIDE = (0, 0, LEFT[1], LEFT[0]), (LEFT[1], 0, RIGHT[1], RIGHT[0])  # boxes of the windows if no monitor is named
OVERLAP = slice(24, 36)  # columns of the camera's view that both projectors light
STRIDE = 8


def write_halves(folder: Path, *, right_camera: tuple[int, int] = CAMERA, right_response: str = "srgb") -> list[Path]:
    """Write calibrations `left` and `right`; each projector lights 36 of the 60 columns of the camera's view."""
    rng = np.random.default_rng(20060504)
    ends = OVERLAP.stop, CAMERA[1] - OVERLAP.start
    rooms = [folder / "left", folder / "right"]
    parts = (LEFT, CAMERA, 0, ends[0], "srgb"), (RIGHT, right_camera, OVERLAP.start, ends[1], right_response)
    for room, (projector, camera, first, width, response) in zip(rooms, parts, strict=True):
        lit = np.zeros(camera, bool)
        lit[:, first : first + width] = True
        block = blurred_transport(rng, (camera[0], int(lit[0].sum())), projector, 0.5)
        places = sparse.csr_array(sparse.eye_array(lit.size, format="csr")[:, np.flatnonzero(lit)])
        tints = rng.uniform(0.5, 1, 3)
        T = tuple(sparse.csr_array(places @ block * tint, dtype=np.float32) for tint in tints)
        devices = Device(*projector, Response(response)), Device(*camera, Response("linear"))
        ambient = np.full((*camera, 3), 0.01, np.float32)
        with writing(room, Calibration(room.name, "made by a test", devices[:1], devices[1], ambient, lit)) as stage:
            write_transport(Transport.from_matrices(T), stage)
    return rooms


def write_monitors(folder: Path, sizes: list[tuple[int, int]]) -> list[Path]:
    """Write calibrations of projectors of (height, width) pixels; one pixel in STRIDE² lights a camera pixel."""
    tiles = [(height // STRIDE, width // STRIDE) for height, width in sizes]
    camera = max(height for height, _ in tiles), sum(width for _, width in tiles)
    albedo = np.random.default_rng(1)
    rooms = []
    for number, (size, tile) in enumerate(zip(sizes, tiles, strict=True)):
        y, x = np.mgrid[: tile[0], : tile[1]].reshape(2, -1)
        rows = y * camera[1] + x + sum(width for _, width in tiles[:number])
        columns = (y * STRIDE + 3) * size[1] + x * STRIDE + 5
        shape = camera[0] * camera[1], size[0] * size[1]
        T = sparse.csr_array((albedo.uniform(0.5, 1, rows.size).astype(np.float32), (rows, columns)), shape=shape)
        mask = np.zeros(camera, bool)
        mask.ravel()[rows] = True
        devices = Device(*size, Response("linear")), Device(*camera, Response("linear"))
        dark = np.zeros((*camera, 3), np.float32)
        rooms.append(folder / f"projector{number}")
        with writing(rooms[-1], Calibration("large", "made by a test", devices[:1], devices[1], dark, mask)) as stage:
            write_transport(Transport.from_matrices((T, T, T)), stage)
    return rooms


def lit_by(scenes: Sequence[Scene]) -> tuple[Calibration, Transport]:
    """Join simulated scenes that differ only in their projectors into one room with all projectors."""
    results = [simulate(scene) for scene in scenes]
    rooms = [simulated_calibration(*each) for each in zip(scenes, results, strict=True)]
    shapes = [room.projector.shape for room in rooms]
    transport = join_transports([result.transport for result in results], shapes)
    mask = np.any([room.mask for room in rooms], axis=0)
    devices = tuple(room.projectors[0] for room in rooms)
    return replace(rooms[0], projectors=devices, mask=mask), replace(transport, camera=rooms[0].camera.shape)


def join(rooms: list[Path], output: Path, *options: object) -> Path:
    here("join", *rooms, "-o", output, *options)
    return output
