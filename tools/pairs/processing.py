"""Fit φ, a projector's colour processing: the light of each primary depends on all three codes.

φ is a table of levels of the primary's own code and of the two other codes, with linear interpolation. Least squares
with a smoothness prior fit it to places where the picture is flat, so that spread and geometry do not matter.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray, IntArray

OWN, OTHER = 17, 7  # levels of a primary's own code, and of each other code
USUAL = 2.2  # gamma that φ is expected to be near
SMOOTH, EVEN = 0.1, 0.02  # weights of second differences from that gamma, and of first differences along other codes
CODES, FINE = 256, 64  # codes of the own and other primaries in the table for pictures


@dataclass(frozen=True)
class Processing:
    """φ of three primaries.

    table : (3, OWN, OTHER, OTHER). Light by the own code and the codes of the next two primaries (cyclic).
    """

    table: FloatArray

    @classmethod
    @cache
    def of_gamma(cls, gamma: float) -> "Processing":
        own = np.linspace(0, 1, OWN) ** gamma
        return cls(np.broadcast_to(own[None, :, None, None], (3, OWN, OTHER, OTHER)).copy())

    def light(self, codes: NDArray[np.floating]) -> NDArray[np.floating]:
        """Convert code values (…, 3) to light."""
        own = np.rint(np.asarray(codes) * (CODES - 1)).astype(np.int32)
        if self._curves is not None:
            return np.stack([self._curves[k][own[..., k]] for k in range(3)], axis=-1)
        other = np.rint(np.asarray(codes) * (FINE - 1)).astype(np.int32)
        parts = [
            self._fine[k][(own[..., k] * FINE + other[..., (k + 1) % 3]) * FINE + other[..., (k + 2) % 3]]
            for k in range(3)
        ]
        return np.stack(parts, axis=-1)

    @cached_property
    def _curves(self) -> NDArray[np.floating] | None:
        """Light by own code, (3, CODES); None if it depends on other codes, whose table takes 0.1 s."""
        if (self.table != self.table[:, :, :1, :1]).any():
            return None
        return _between(self.table[:, :, 0, 0].T, CODES).T.astype(np.float32)

    @cached_property
    def _fine(self) -> NDArray[np.floating]:
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
    """Fit φ, scaled to 0 at black and 1 at white.

    codes : (samples, 3).
    light : (samples, 3). Light relative to white, with any offset.
    weights : (samples, 3). Inverse variances.
    """
    tables = []
    for k in range(3):
        turned = codes[:, [k, (k + 1) % 3, (k + 2) % 3]]
        cells, shares = _hats(turned)
        weight = weights[:, k] / weights[:, k].mean()
        size = OWN * OTHER * OTHER
        J, h = np.zeros(size * size), np.zeros(size)
        usual = Processing.of_gamma(USUAL).table[k].ravel()
        rest = light[:, k] - sum(share * usual[cell] for cell, share in zip(cells, shares, strict=True))
        for a in range(8):
            h += np.bincount(cells[a], weight * shares[a] * rest, size)
            for b in range(8):
                J += np.bincount(cells[a] * size + cells[b], weight * shares[a] * shares[b], size * size)
        J = J.reshape(size, size) + len(codes) / size * _prior()
        tables.append((usual + np.linalg.solve(J, h)).reshape(OWN, OTHER, OTHER))
    table = np.stack(tables)
    black, white = (table[:, [end], [end], [end]][..., None, None] for end in (0, -1))
    return Processing((table - black) / (white - black))


def level_shares(codes: NDArray[np.uint8], level: int) -> NDArray[np.floating]:
    """Return the share of one of the OWN levels in the light of each code value, of the same shape."""
    place = np.arange(CODES) / (CODES - 1) * (OWN - 1)
    return np.asarray(np.maximum(0, 1 - np.abs(place - level)).astype(np.float32)[codes])


def fit_response(shares: FloatArray, light: FloatArray, weights: FloatArray) -> Processing:
    """Fit a processing without dependence on other codes: rising curves from 0 to 1.

    shares : (samples, 3, OWN). Share of each level in the light of a sample.
    light, weights : as for `fit_processing`.
    """
    curves, usual = [], np.linspace(0, 1, OWN) ** USUAL
    D = SMOOTH * np.diff(np.eye(OWN), 2, axis=0)
    for k in range(3):
        B, w = shares[:, k], weights[:, k] / weights[:, k].mean()
        rest = light[:, k] - B @ usual
        curve = usual + np.linalg.solve(B.T @ (B * w[:, None]) + len(B) / OWN * D.T @ D, B.T @ (w * rest))
        steps = np.maximum(np.diff(curve), 1e-4 * (curve[-1] - curve[0]))
        curves.append(np.concatenate([[0], np.cumsum(steps) / steps.sum()]))
    table = np.stack(curves)[:, :, None, None]
    return Processing(np.broadcast_to(table, (3, OWN, OTHER, OTHER)).copy())


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


@cache
def _prior() -> FloatArray:
    eyes = [np.eye(OWN), np.eye(OTHER), np.eye(OTHER)]
    total = np.zeros((OWN * OTHER * OTHER,) * 2)
    for axis, levels in enumerate((OWN, OTHER, OTHER)):
        orders = [(2, SMOOTH)] if axis == 0 else [(2, SMOOTH), (1, EVEN)]
        for order, strength in orders:
            each = list(eyes)
            each[axis] = np.diff(np.eye(levels), order, axis=0) * strength
            D = np.kron(np.kron(each[0], each[1]), each[2])
            total += D.T @ D
    return total
