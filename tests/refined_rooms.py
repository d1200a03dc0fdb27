"""Small physical room for tests of refinement: T ≥ 0, and every map made from this T."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.calibration import Calibration, Device
from counterlight.maps.room_maps import RoomMaps
from counterlight.pipeline.room import Room
from counterlight.response import Response
from counterlight.tools.inverse.far_light import undo_far_light
from counterlight.tools.inverse.refinement_maps import pack_chain, refinement_maps
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import Csr, FarLight, Transport, far_light_of, stacked
from tests.packing import pack_matrices
from tests.rooms import CAMERA, CELLS, PROJECTOR, blurred_transport

DARK = 40  # a projector pixel that lights nothing
DAMPING = 0.1


@dataclass(frozen=True)
class PhysicalRoom:
    """Room with its transport, and dense T per channel, (3, camera pixels, projector pixels)."""

    room: Room
    transport: Transport
    dense: NDArray[np.float64]

    @property
    def inside(self) -> NDArray[np.bool_]:
        return self.room.calibration.mask.ravel()


def physical_room(rng: np.random.Generator, *, far: bool = True, start: str = "previous") -> PhysicalRoom:
    """Blurred, textured, tinted surface, a mask with holes, a dark projector pixel and, if asked, far light."""
    near = _near(rng)
    transport = Transport.from_matrices(near, _far(rng) if far else None)
    mask = rng.uniform(size=CAMERA) < 0.85
    device = Device(*PROJECTOR, Response("srgb"))
    ambient = rng.uniform(0, 0.02, (*CAMERA, 3)).astype(np.float32)
    calibration = Calibration(
        "physical", "made by a test", (device,), Device(*CAMERA, Response("linear")), ambient, mask
    )
    inverse = tuple(_inverse(T, mask.ravel()) for T in near)
    chain = undo = None
    if transport.far is not None:
        chain = pack_chain(transport.far, CAMERA, PROJECTOR)
        undo = pack_chain(undo_far_light(transport.far, stacked(inverse)), CAMERA, CAMERA)
    objective = replace(Objective.plain(transport.inside(mask)), weights=mask.ravel().astype(np.float64))
    maps = RoomMaps(
        pack_matrices(inverse, PROJECTOR, CAMERA),
        pack_matrices(near, CAMERA, PROJECTOR),
        chain,
        undo,
        0.5,
        refinement=refinement_maps(objective, CAMERA, PROJECTOR),
    )
    return PhysicalRoom(Room(calibration, maps, 0.5, start=start), transport, _written_out(transport))


def _near(rng: np.random.Generator) -> tuple[Csr, ...]:
    blur = blurred_transport(rng, CAMERA, PROJECTOR, 0.6).tolil()
    blur[:, DARK] = 0
    tints = rng.uniform(0.5, 1, (3, blur.shape[0], 1))
    return tuple(sparse.csr_array(blur.multiply(tint), dtype=np.float32) for tint in tints)


def _far(rng: np.random.Generator) -> FarLight:
    cells, projector, camera = CELLS[1], PROJECTOR[0] * PROJECTOR[1], CAMERA[0] * CAMERA[1]
    gather = rng.uniform(0, 2 / projector, (3, cells, projector)) * (rng.uniform(size=(cells, projector)) < 0.4)
    gather[:, :, DARK] = 0
    scatter = rng.uniform(0, 1, (3, camera, cells)) * (rng.uniform(size=(camera, cells)) < 0.5)
    mix = rng.uniform(0, 0.3, (3, cells, cells))
    return far_light_of(tuple(map(Csr, gather)), mix, tuple(map(Csr, scatter)))


def _inverse(T: Csr, inside: NDArray[np.bool_]) -> Csr:
    kept = np.where(inside[:, None], T.toarray(), 0).astype(np.float64)
    damping = (DAMPING * np.linalg.norm(kept, 2)) ** 2
    return Csr(np.linalg.solve(kept.T @ kept + damping * np.eye(kept.shape[1]), kept.T))


def _written_out(transport: Transport) -> NDArray[np.float64]:
    columns = []
    for pixel in range(transport.shape[1]):
        drive = np.zeros((transport.shape[1], 3))
        drive[pixel] = 1
        columns.append(transport.apply(drive).T)
    return np.stack(columns, axis=2)
