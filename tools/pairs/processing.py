"""Fit φ, a projector's colour processing: the light of each primary depends on all three codes.

φ is a table of levels of the primary's own code and of the two other codes, with linear interpolation. Least squares
with a smoothness prior fit it to places where the picture is flat, so that spread and geometry do not matter.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray

OWN, OTHER = 17, 7  # levels
SMOOTH, EVEN = 0.3, 0.03  # weights of second differences, and of first differences along other codes
CODES, FINE = 256, 64  # codes of the own and other primaries in the table for pictures


@dataclass(frozen=True)
class Processing:
    """φ of three primaries.

    table : (3, OWN, OTHER, OTHER). Light by the own code and the codes of the next two primaries (cyclic).
    """

    table: FloatArray

    @classmethod
    def of_gamma(cls, gamma: float) -> "Processing":
        own = np.linspace(0, 1, OWN) ** gamma
        return cls(np.broadcast_to(own[None, :, None, None], (3, OWN, OTHER, OTHER)).copy())

    def light(self, codes: NDArray[np.floating]) -> NDArray[np.float32]:
        """Convert code values (…, 3) to light."""
        own = np.rint(np.asarray(codes) * (CODES - 1)).astype(np.int32)
        other = np.rint(np.asarray(codes) * (FINE - 1)).astype(np.int32)
        parts = [
            self._fine[k][(own[..., k] * FINE + other[..., (k + 1) % 3]) * FINE + other[..., (k + 2) % 3]]
            for k in range(3)
        ]
        return np.stack(parts, axis=-1)

    @cached_property
    def _fine(self) -> NDArray[np.float32]:
        fine = self.table
        for axis, count in ((1, CODES), (2, FINE), (3, FINE)):
            fine = np.moveaxis(_between(np.moveaxis(fine, axis, 0), count), 0, axis)
        return np.ascontiguousarray(fine.reshape(3, -1), np.float32)


def _between(table: FloatArray, count: int) -> FloatArray:
    place = np.linspace(0, len(table) - 1, count)
    low = np.minimum(place.astype(int), len(table) - 2)
    share = (place - low).reshape(-1, *[1] * (table.ndim - 1))
    return np.asarray((1 - share) * table[low] + share * table[low + 1])


def fit_processing(codes: FloatArray, light: FloatArray, weights: FloatArray) -> Processing:
    """Fit φ.

    codes : (samples, 3).
    light : (samples, 3). Light relative to white.
    weights : (samples, 3). Inverse variances.
    """
    tables = []
    for k in range(3):
        turned = codes[:, [k, (k + 1) % 3, (k + 2) % 3]]
        cells, shares = _hats(turned)
        weight = weights[:, k] / weights[:, k].mean()
        size = OWN * OTHER * OTHER
        J, h = np.zeros(size * size), np.zeros(size)
        for a in range(8):
            h += np.bincount(cells[a], weight * shares[a] * light[:, k], size)
            for b in range(8):
                J += np.bincount(cells[a] * size + cells[b], weight * shares[a] * shares[b], size * size)
        scale = len(codes) / size
        J = J.reshape(size, size) + scale * _prior()
        J[np.arange(OTHER**2), np.arange(OTHER**2)] += 0.0
        tables.append(np.linalg.solve(J, h).reshape(OWN, OTHER, OTHER))
    return Processing(np.stack(tables))


def _hats(codes: FloatArray) -> tuple[list[IntArray], list[FloatArray]]:
    levels = np.array([OWN, OTHER, OTHER])
    place = np.clip(codes, 0, 1) * (levels - 1)
    low = np.minimum(place.astype(int), levels - 2)
    share = place - low
    cells, shares = [], []
    for corner in np.ndindex(2, 2, 2):
        at = low + corner
        cells.append((at[:, 0] * OTHER + at[:, 1]) * OTHER + at[:, 2])
        shares.append(np.prod(np.where(np.array(corner) == 1, share, 1 - share), axis=1))
    return cells, shares


def _prior() -> FloatArray:
    eyes = [np.eye(OWN), np.eye(OTHER), np.eye(OTHER)]
    total = np.zeros((OWN * OTHER * OTHER,) * 2)
    for axis, levels in enumerate((OWN, OTHER, OTHER)):
        orders = [(2, SMOOTH)] if axis == 0 else [(2, SMOOTH), (1, EVEN)]
        for order, strength in orders:
            each = [eye for eye in eyes]
            each[axis] = np.diff(np.eye(levels), order, axis=0) * strength
            D = np.kron(np.kron(each[0], each[1]), each[2])
            total += D.T @ D
    return total
