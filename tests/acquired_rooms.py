"""Simulated rooms with a known T, for tests of acquisition."""

from pathlib import Path

import cv2
import numpy as np
from hypothesis import strategies as st
from scipy import sparse

from counterlight.response import Response
from counterlight.tools.acquisition.acquire import Acquisition, acquire
from counterlight.tools.acquisition.cameras.camera import Camera
from counterlight.tools.acquisition.cameras.simulated import CameraSettings, SimulatedCamera, SimulatedRoom
from counterlight.tools.acquisition.plan import MakeScheme
from counterlight.tools.acquisition.store import MemoryStore, Wanted, open_store
from counterlight.tools.simulation.devices import Sensor
from counterlight.tools.transport.transport import Transport, channels, far_light_of
from tests.rooms import blurred_transport

CAMERA, PROJECTOR = (18, 26), (21, 30)
SHAPE = CAMERA[0] * CAMERA[1], PROJECTOR[0] * PROJECTOR[1]
LINEAR = Response("linear")
SEEDS = st.integers(0, 2**32 - 1)
QUIET = CameraSettings(Sensor(0, 0, 16))
NOISY = CameraSettings(Sensor(20000, 5, 14))


def dense(transport: Transport) -> np.ndarray:
    """Returns T, near and far light: (3, camera pixels, projector pixels)."""
    return np.stack([transport.apply(np.repeat(column[:, None], 3, 1)) for column in np.eye(transport.shape[1])]).T


def error(found: Transport, truth: Transport) -> float:
    """Relative Frobenius error of the measured T."""
    return float(np.linalg.norm(dense(found) - dense(truth)) / np.linalg.norm(dense(truth)))


def room_of(transport: Transport, ambient: float = 0.01, projector: tuple[int, int] = PROJECTOR) -> SimulatedRoom:
    picture = np.full((*CAMERA, 3), ambient, np.float32)
    return SimulatedRoom("test", transport, picture, (projector,), LINEAR.over(projector))


def sharp_wall(rng: np.random.Generator, sigma: float = 0.5) -> Transport:
    T = blurred_transport(rng, CAMERA, PROJECTOR, sigma)
    tints = rng.uniform(0.5, 1, (3, SHAPE[0], 1))
    return Transport.from_matrices(tuple(sparse.csr_array(T.multiply(tint), dtype=np.float32) for tint in tints))


def with_far_light(near: Transport, share: float) -> Transport:
    """Add far light: every projector pixel lights every camera pixel a little, with `share` of all light."""
    flood = near.composition()
    pixels = near.shape[1]
    cells = sparse.csr_array(np.full((1, pixels), 1 / pixels))
    scatter = tuple(sparse.csr_array(share / (1 - share) * flood[:, i : i + 1]) for i in range(3))
    return Transport(near.near, far_light_of((cells,) * 3, np.ones((3, 1, 1)), scatter))


def mirror(rng: np.random.Generator) -> Transport:
    """T of a wall with a mirror: the upper half of the camera also sees a mirrored copy of the projector picture."""
    T = sharp_wall(rng).near
    row, column = np.mgrid[: PROJECTOR[0], : PROJECTOR[1]]
    flipped = (row * PROJECTOR[1] + PROJECTOR[1] - 1 - column).ravel()
    half = sparse.diags_array(np.repeat(np.arange(CAMERA[0]) < CAMERA[0] // 2, CAMERA[1]).astype(np.float32))
    return Transport.from_matrices(tuple(sparse.csr_array(M + 0.6 * (half @ M[:, flipped])) for M in channels(T)))


def shown_by(path: Path) -> np.ndarray:
    """Read the code values of a PNG picture: (height, width, 3) RGB."""
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    assert picture is not None, path
    return picture[..., ::-1]


def run(
    room: SimulatedRoom,
    scheme: MakeScheme,
    settings: CameraSettings = NOISY,
    camera: Camera | None = None,
    given: Response | None = None,
) -> Acquisition:
    camera = camera or SimulatedCamera(room, settings)
    return acquire(camera, MemoryStore(camera.exposures), scheme, room.projectors, given)[0]


def run_on_disk(folder: Path, room: SimulatedRoom, scheme: MakeScheme) -> Acquisition:
    camera = SimulatedCamera(room, NOISY)
    session, wanted = {"camera": camera.name}, Wanted(folder / "room")
    with open_store(folder / "captures", session, camera.exposures, wanted) as store:
        return acquire(camera, store, scheme, room.projectors)[0]
