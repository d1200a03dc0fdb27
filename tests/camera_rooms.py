"""Rooms of one projector and several cameras, made from known maps of camera pixels to projector positions."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import sparse

from counterlight.calibration import Calibration, Device, writing
from counterlight.response import Response
from counterlight.tools.simulation.geometry import trace
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.transport.storage import write_transport
from counterlight.tools.transport.transport import Transport
from tests.programs import here

PROJECTOR = (27, 48)
FIRST, SECOND = (36, 50), (32, 44)  # (height, width) of the cameras
SPREAD = 0.6  # σ of a footprint, in projector pixels
LINEAR = Response("linear")
Map = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]  # camera pixel -> projector position


def homography(H: np.ndarray) -> Map:
    def where(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u, v, w = np.einsum("ij,jn->in", H, np.stack([x, y, np.ones_like(x)]))
        return u / w, v / w

    return where


# The first camera sees the projector's left two thirds and the second its right two thirds, each at an angle.
LEFT = np.array([[0.62, 0.03, 2.0], [-0.02, 0.65, 2.0], [0.0008, 0.0003, 1.0]])
RIGHT = np.array([[0.66, -0.03, 17.0], [0.02, 0.7, 2.5], [-0.0006, 0.0004, 1.0]])
# Maps pixels of the first projector to pixels of a second projector, whose picture overlaps the first at an angle.
BESIDE = np.array([[0.94, 0.05, -4.0], [-0.04, 1.02, 1.5], [0.0, 0.0002, 1.0]])


def beside(H: np.ndarray) -> Map:
    """Map from camera pixels to the second projector, which lights the same paint."""
    return homography(BESIDE @ H)


def folded(H: np.ndarray, fold: float = 24.0, bend: float = 0.25) -> Map:
    """Map to a wall that turns away beyond the projector column `fold`: the camera sees that part compressed."""
    straight = homography(H)

    def where(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u, v = straight(x, y)
        return u + bend * np.maximum(u - fold, 0), v

    return where


def paint(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Reflectance of the wall at projector positions (u, v), (n, 3)."""
    wave = np.sin(u / 2.3) * np.cos(v / 1.7)
    return np.stack([0.7 + 0.2 * wave, 0.65 - 0.15 * wave, 0.6 + 0.1 * np.sin(v / 3)], axis=-1)


def centres(camera: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[: camera[0], : camera[1]].reshape(2, -1) + 0.5
    return x, y


def transport_seen(
    camera: tuple[int, int], where: Map, gain: tuple[float, float, float] = (1, 1, 1), painted: Map | None = None
) -> Transport:
    """T of a wall with Gaussian footprints around the projector position of each camera pixel.

    painted : map from camera pixels to positions on the paint; None uses `where`.
    """
    u, v = where(*centres(camera))
    on_paint = (painted or where)(*centres(camera))
    row, column = np.mgrid[: PROJECTOR[0], : PROJECTOR[1]].reshape(2, -1) + 0.5
    weights = np.exp(-((column - u[:, None]) ** 2 + (row - v[:, None]) ** 2) / (2 * SPREAD**2))
    weights[weights < 1e-3] = 0
    light = weights / (2 * np.pi * SPREAD**2)
    colours = (paint(*on_paint) * gain).T
    near = [sparse.csr_array((light * colour[:, None]).astype(np.float32)) for colour in colours]
    return Transport.from_matrices(near, camera=camera, projector=PROJECTOR)


def calibration_of(transport: Transport, name: str, ambient: float = 0.01) -> Calibration:
    """Calibration whose mask keeps camera pixels with most of their footprint inside the picture."""
    assert transport.camera is not None
    light = transport.composition().reshape(*transport.camera, 3)
    mask = light.min(axis=2) > 0.35
    picture = np.full((*transport.camera, 3), ambient, np.float32)
    devices = Device(*PROJECTOR, Response("srgb")), Device(*transport.camera, LINEAR)
    return Calibration(name, "made by a test", devices[:1], devices[1], picture, mask)


def write_views(
    folder: Path,
    gain: tuple[float, float, float] = (1, 1, 1),
    bend: Callable[[np.ndarray], Map] = homography,
    painted: Callable[[np.ndarray], Map] | None = None,
) -> list[Path]:
    """Write calibrations `first` and `second`, one per camera.

    gain : RGB gain of the second camera.
    bend : converts a camera's homography to its map to the projector picture.
    painted : converts a camera's homography to its map to the paint; None uses `bend`.
    """
    rooms = []
    for name, camera, H, factor in (("first", FIRST, LEFT, (1, 1, 1)), ("second", SECOND, RIGHT, gain)):
        transport = transport_seen(camera, bend(H), factor, painted(H) if painted else None)  # type: ignore[arg-type]
        rooms.append(folder / name)
        with writing(rooms[-1], calibration_of(transport, name)) as stage:
            write_transport(transport, stage)
    return rooms


def write_pairs(folder: Path, gain: tuple[float, float, float] = (1, 1, 1)) -> list[Path]:
    """Write calibrations `first pair` and `second pair`: two projectors, as each camera sees them.

    gain : RGB gain of the second camera.
    """
    alone = write_views(folder / "one", gain), write_views(folder / "other", gain, beside, homography)
    pairs = []
    for views in zip(*alone, strict=True):
        pairs.append(folder / f"{views[0].name} pair")
        here("join", *views, "-o", pairs[-1])
    return pairs


def position_in_first(camera: tuple[int, int], H: np.ndarray) -> np.ndarray:
    """Position in the first camera of the wall point that each pixel of a camera sees, (height, width, 2)."""
    u, v = homography(H)(*centres(camera))
    return np.stack(homography(np.linalg.inv(LEFT))(u, v), axis=-1).reshape(*camera, 2)


def looks_at(scene: Scene, other: Scene) -> np.ndarray:
    """Position in `other`'s camera of the point that each pixel of `scene`'s camera sees, (height, width, 2)."""
    directions, _ = scene.camera.pixel_rays(range(scene.camera.height), 1)
    x, y, _ = other.camera.project(trace(scene.camera.position, directions, scene.surfaces).point)
    return np.stack([x, y], axis=-1).reshape(scene.camera.height, scene.camera.width, 2)
