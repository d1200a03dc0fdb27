"""Rooms that changed after calibration: the projector picture or a camera moved, or a light dimmed."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration, StoredCalibration, writing
from counterlight.pipeline.drift import Moved
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import Transport, channels


def write_changed(
    folder: Path,
    stored: StoredCalibration,
    *,
    shift: tuple[float, float] = (0, 0),
    shifts: Sequence[tuple[float, float]] = (),
    lamps: Sequence[float] = (),
    camera: tuple[int, int] = (0, 0),
    cameras: Sequence[tuple[int, int]] = (),
    exposures: Sequence[float] = (),
    light: tuple[float, float, float] = (1, 1, 1),
    ambient: float = 1.0,
) -> None:
    """Write a changed room that a simulated camera can capture.

    shift : shift of the projector picture in projector pixels, right and down; pixels are boxes of light.
    shifts : one shift per projector.
    lamps : remaining share of each projector's light.
    camera : shift of the camera in whole pixels.
    cameras : one shift per camera.
    exposures : gain of each camera.
    light : gain per colour channel.
    ambient : gain of the ambient light.
    """
    room, transport = stored.calibration, read_transport(stored)
    boxes = _boxes(room, shifts or [shift] * len(room.regions), lamps or [1.0] * len(room.regions))
    turned = _turned(room, cameras or [camera] * len(room.views))
    exposed = np.ones(room.camera.shape)
    for view, exposure in zip(room.views, exposures, strict=False):
        exposed[view] = exposure
    near = [
        sparse.csr_array(sparse.diags_array(gain * exposed.ravel()) @ (matrix[turned] @ boxes), dtype=np.float32)
        for gain, matrix in zip(light, channels(transport.near), strict=True)
    ]
    seen = ambient * room.ambient.reshape(-1, 3)[turned].reshape(room.ambient.shape) * exposed[..., None]
    seen = seen.astype(np.float32)
    with writing(folder, replace(room, ambient=seen)) as stage:
        write_transport(Transport.from_matrices(near), stage)


def _turned(room: Calibration, cameras: Sequence[tuple[int, int]]) -> np.ndarray:
    """Old raster index that each camera pixel of the raster sees now."""
    number = np.arange(room.camera.pixels).reshape(room.camera.shape)
    for view, moved in zip(room.views, cameras, strict=True):
        own = number[view]
        number[view] = own.ravel()[rolled_rows(own.shape, moved)].reshape(own.shape)  # type: ignore[arg-type]
    return number.ravel()


def _boxes(room: Calibration, shifts: Sequence[tuple[float, float]], lamps: Sequence[float]) -> sparse.csr_array:
    """Shifted boxes of every projector, each in its own region of the raster."""
    number = np.arange(room.projector.pixels).reshape(room.projector.shape)
    total = sparse.csr_array((number.size, number.size))
    for (left, top, width, height), shift, lamp in zip(room.regions, shifts, lamps, strict=True):
        own = number[top : top + height, left : left + width].ravel()
        part = sparse.coo_array(shifted_boxes((height, width), shift))
        total += sparse.coo_array((lamp * part.data, (own[part.row], own[part.col])), shape=total.shape)
    return sparse.csr_array(total)


def shifted_boxes(shape: tuple[int, int], shift: tuple[float, float]) -> sparse.csr_array:
    """Share of each calibrated pixel that each shifted pixel covers, (pixels, pixels)."""
    across, down = (_shares(n, s) for n, s in zip(shape[::-1], shift, strict=True))
    return sparse.csr_array(sparse.kron(down, across))


def _shares(count: int, shift: float) -> FloatArray:
    """Overlap of the unit box i with the box j + shift, (i, j)."""
    i, j = np.arange(count)[:, None], np.arange(count)
    return np.maximum(0, 1 - np.abs(j + shift - i))


def rolled_rows(shape: tuple[int, int], moved: tuple[int, int]) -> np.ndarray:
    """Old pixel that each pixel of a camera sees after a shift right and down; border pixels repeat."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    y, x = np.clip(y + moved[1], 0, shape[0] - 1), np.clip(x + moved[0], 0, shape[1] - 1)
    return np.asarray((y * shape[1] + x).ravel())


def moved_by(right: float, down: float, gain: float = 1.0) -> Moved:
    return Moved(np.array([[1, 0, right], [0, 1, down], [0, 0, 1.0]]), np.full(3, gain))
