"""Small rooms far out of focus: T of discs, entry by entry in numpy, and the same T compressed into cells."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight.calibration import Calibration, Device, writing
from counterlight.maps.row_map import SparseRows
from counterlight.response import Response
from counterlight.tools.blurring.pruning import Pyramid, in_cells
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Dense, FarLight, Transport, dense_rows

CAMERA, PROJECTOR = (29, 35), (27, 31)  # no block divides these sizes
LIMIT = 0.008


def discs(
    rng: np.random.Generator,
    radius: float,
    camera: tuple[int, int] = CAMERA,
    projector: tuple[int, int] = PROJECTOR,
    tinted: bool = True,
) -> NDArray[np.float64]:
    """Returns T, (3, camera pixels, projector pixels): a camera pixel sees a soft-edged disc of projector pixels."""
    y, x = np.mgrid[: camera[0], : camera[1]].reshape(2, -1, 1)
    v, u = np.mgrid[: projector[0], : projector[1]].reshape(2, 1, -1)
    away = np.hypot((y + 0.5) * projector[0] / camera[0] - v - 0.5, (x + 0.5) * projector[1] / camera[1] - u - 0.5)
    disc = np.clip(radius + 0.5 - away, 0, 1)
    paint = rng.uniform(0.4, 1, (3 if tinted else 1, disc.shape[0], 1))
    return np.asarray(np.broadcast_to(paint * disc / (np.pi * radius**2), (3, *disc.shape)))


def rows_of(T: NDArray[np.float64]) -> SparseRows:
    """Convert T to sparse float32 rows without zeros."""
    rows = dense_rows(T.astype(np.float32))
    return rows.inside(np.ones(rows.shape[0], bool))


def in_blocks(
    T: NDArray[np.float64],
    limit: float = LIMIT,
    far: FarLight | None = None,
    camera: tuple[int, int] = CAMERA,
    projector: tuple[int, int] = PROJECTOR,
) -> Transport:
    """Compress T to S + B P: near light plus blurred light."""
    near, scatter = in_cells(rows_of(T), projector, limit)
    return Transport(near, far, camera, projector, Pyramid(projector).light(scatter))


def written_out(T: Transport) -> NDArray[np.float64]:
    """Expand T to a dense (3, camera pixels, projector pixels) with numpy alone."""

    def dense(rows: SparseRows) -> NDArray[np.float64]:
        full = np.zeros((3, *rows.shape))
        np.add.at(full, (slice(None), rows.rows, rows.indices), rows.weights.T.astype(np.float64))
        return full

    whole = dense(T.near)
    if T.blurred is not None:
        whole += dense(T.blurred.scatter) @ dense(T.blurred.gather)
    if T.far is not None:
        whole += dense(T.far.scatter) @ T.far.mix.matrices @ dense(T.far.gather)
    return whole


def write_room(folder: Path, transport: Transport) -> None:
    """Write a calibration folder whose mask includes all camera pixels."""
    with writing(folder, calibrated(transport)) as stage:
        write_transport(transport, stage)


def calibrated(transport: Transport) -> Calibration:
    """Calibration of a room with this transport."""
    assert transport.camera is not None
    assert transport.projector is not None
    devices = Device(*transport.projector, Response("srgb")), Device(*transport.camera, Response("linear"))
    ambient = np.full((*transport.camera, 3), 0.01, np.float32)
    return Calibration("discs", "made by a test", devices[:1], devices[1], ambient, np.ones(transport.camera, bool))


def far_light(shape: tuple[int, int]) -> FarLight:
    """Far light of two cells, a tenth of all light. Each cell averages the picture; every camera pixel sees both."""
    rows, columns = shape
    gather = dense_rows(np.full((3, 2, columns), 1 / columns))
    return FarLight(gather, Dense(np.full((3, 2, 2), 0.1)), dense_rows(np.full((3, rows, 2), 0.2)))
