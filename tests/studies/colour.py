"""python -m tests.studies.colour: tiers of colour below the optimum of nine matrices, by how alike primaries look."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from counterlight.pipeline.content import psnr
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.transport import Transport
from tests.coloured_rooms import ColouredRoom, coloured_room, mixing_of_condition

CAMERA, PROJECTOR = (24, 32), (14, 19)
CONDITIONS = (1.3, 4.0, 16.0, 64.0)
PAINT = 0.1  # divided by the condition number: otherwise no camera would treat such paint as neutral
NOISE = 0.005
TIERS = ("independent", "global", "pixel", "auto")


def measured(room: ColouredRoom, rng: np.random.Generator, noise: float) -> ColouredRoom:
    """Add relative noise to T's entries and to the floodlights."""
    near = room.transport.near
    weights = near.weights * (1 + noise * rng.normal(size=near.weights.shape)).astype(np.float32)
    F = room.calibration.primaries
    assert F is not None
    noisy = F * (1 + noise * rng.normal(size=F.shape)).astype(np.float32)
    transport = Transport(replace(near, weights=weights), None, room.transport.camera, room.transport.projector)
    return ColouredRoom(replace(room.calibration, primaries=noisy), transport, room.nine)


def distances(condition: float, noise: float) -> list[str]:
    """Returns dB below the optimum in the order of TIERS, and the tier that auto chose."""
    rng, neutral = np.random.default_rng(3), mixing_of_condition(condition)
    room = coloured_room(rng, neutral, paint=PAINT / condition, camera=CAMERA, projector=PROJECTOR)
    y, x = np.mgrid[: CAMERA[0], : CAMERA[1]] / CAMERA[1]
    Q = np.linalg.inv(neutral)
    desired = 0.42 * np.stack([0.3 + 0.4 * x, 0.7 - 0.5 * y, 0.4 + 0.2 * np.sin(5 * x)], axis=2)
    best, found = optimum(room, Q, desired), list[str]()
    given = measured(room, rng, noise) if noise else room
    for colour in TIERS:
        tier = tier_of(given.calibration, given.transport, colour)
        drive = prepare("box", tier.transport, room.calibration.mask).solve(tier.target(desired)).drive
        seen = room.radiance(drive) @ Q.T
        found.append(f"{best - psnr(float(np.mean((seen - desired) ** 2))):.2f}")
    return [*found, tier.mixing.tier]


def optimum(room: ColouredRoom, Q: NDArray[np.float64], desired: NDArray[np.float64]) -> float:
    """Returns the PSNR of the best drive within 0..1 for all nine matrices, with errors in screen primaries."""
    _, _, rows, columns = room.nine.shape
    A = np.einsum("mk,klij->milj", Q, room.nine).reshape(3 * rows, 3 * columns)
    b = (desired - room.calibration.ambient @ Q.T).reshape(-1, 3).T.ravel()
    return psnr(float(np.mean((A @ lsq_linear(A, b, (0, 1)).x - b) ** 2)))


def main() -> None:
    print(
        "| condition of the mixing | noise of T and F | "
        + " | ".join(TIERS[:3])
        + " | auto takes |\n|---|---|---|---|---|---|"
    )
    for condition in CONDITIONS:
        for noise in (0.0, NOISE):
            *figures, _, chosen = distances(condition, noise)
            print(f"| {condition:g} | {100 * noise:g} % | {' | '.join(figures)} | {chosen} |", flush=True)


if __name__ == "__main__":
    main()
