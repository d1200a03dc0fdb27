"""Rooms whose camera channels see several primaries: all nine matrices, without the product's code for mixing."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.calibration import Calibration, Device
from counterlight.maps.mixing import Mixing
from counterlight.pipeline.room import Room
from counterlight.response import Response
from counterlight.tools.transport.transport import Csr, Transport
from tests.rooms import CAMERA, PROJECTOR, blurred_transport

FloatArray = NDArray[np.float64]
LEDS = np.array([[0.95, 0.04, 0.01], [0.05, 0.90, 0.05], [0.00, 0.06, 0.94]])
WHEEL = np.array([[0.80, 0.17, 0.03], [0.12, 0.78, 0.10], [0.02, 0.14, 0.84]])
# 12 % of white comes from neighbouring primaries
CROSSTALK = np.array([[0.88, 0.08, 0.04], [0.06, 0.88, 0.06], [0.03, 0.09, 0.88]])


@dataclass(frozen=True)
class ColouredRoom:
    """Room as an acquisition measures it, with its true nine matrices."""

    calibration: Calibration
    transport: Transport
    nine: FloatArray

    def radiance(self, drive: FloatArray) -> FloatArray:
        """Compute c_k = Σ_l T_kl p_l + e_k (thesis eq. 4.1) as a picture; drive is (projector pixels, 3)."""
        light = np.einsum("klij,jl->ik", self.nine, drive.reshape(-1, 3))
        return np.asarray(light.reshape(*self.calibration.camera.shape, 3) + self.calibration.ambient)


def mixing_of_condition(condition: float) -> FloatArray:
    """Returns (1 − s) I + s/3, whose rows sum to 1; its singular values are 1, and twice 1 − s = 1 / condition."""
    share = 1 - 1 / condition
    return (1 - share) * np.eye(3) + share / 3


def coloured_room(
    rng: np.random.Generator,
    neutral: FloatArray = CROSSTALK,
    *,
    paint: float = 0.0,
    camera: tuple[int, int] = CAMERA,
    projector: tuple[int, int] = PROJECTOR,
    ambient: float = 0.01,
    shift: tuple[float, float] = (0, 0),
) -> ColouredRoom:
    """Blurred surface, a third of it white: F_kl = M_kl ρ_l (1 ± paint), with a random colour per field of 5x4 pixels.

    paint : relative difference of the reflectance between a channel and the primary's peak.
    shift : shift of the projector picture, in projector pixels right and down.
    """
    G = blurred_transport(rng, camera, projector, 0.6, shift).toarray().astype(np.float64)
    G /= G.sum(axis=1, keepdims=True)
    white = _fields(rng.uniform(size=camera), camera) < 1 / 3
    reflectance = np.where(white[:, None], 1.0, _fields(rng.uniform(0.45, 1, (*camera, 3)), camera))
    within = np.where(white[:, None, None], 1.0, 1 + paint * _fields(rng.uniform(-1, 1, (*camera, 3, 3)), camera))
    F = neutral * reflectance[:, None, :] * within
    nine = np.einsum("ikl,ij->klij", F, G)
    primaries = np.moveaxis(F, 2, 0).reshape(3, *camera, 3).astype(np.float32)
    light = (ambient * rng.uniform(0.5, 1, (*camera, 3))).astype(np.float32)
    calibration = Calibration(
        "coloured",
        "made by a test",
        (Device(*projector, Response("linear")),),
        Device(*camera, Response("linear")),
        light,
        np.ones(camera, bool),
        primaries,
    )
    acquired = [Csr(nine[k].sum(axis=0).astype(np.float32)) for k in range(3)]  # captured with white patterns
    return ColouredRoom(calibration, Transport.from_matrices(acquired, camera=camera, projector=projector), nine)


def _fields(values: FloatArray, camera: tuple[int, int]) -> FloatArray:
    """Make values constant within fields of 5 × 4 pixels, (camera pixels, …)."""
    y, x = np.mgrid[: camera[0], : camera[1]]
    return np.asarray(values[y // 4, x // 5].reshape(-1, *values.shape[2:]))


def with_mixing(room: Room, rng: np.random.Generator) -> Room:
    """Add a mixing per camera pixel to a room; in some camera pixels, grey does not need one of the primaries."""
    B = np.eye(3) + 0.3 * rng.uniform(-1, 1, (*room.calibration.camera.shape, 3, 3))
    B[::4, ::3, :, 1] = [0.9, 0.9, 0.6]
    B[::4, ::3, 2] += [0, 0, 0.9]
    B /= np.linalg.norm(B, axis=2, keepdims=True)
    return replace(room, maps=replace(room.maps, mixing=Mixing(CROSSTALK, B.astype(np.float32))))
