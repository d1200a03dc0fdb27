"""Correct places that are off by a period: compare captures with predictions for places one period away."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.acquisition.few.near import Windows
from counterlight.tools.acquisition.few.order import PERIOD
from counterlight.tools.acquisition.few.places import Spots, averaged
from counterlight.tools.acquisition.few.seen import Seen, Table, some

BESIDE = PERIOD * np.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]])
SPREAD = 0.7  # σ in camera pixels over which misfits are averaged
CLEARLY = 0.5  # a place is moved if the misfit falls below this share of its present value


def settled(seen: Seen, table: Table, spots: Spots, pictures: Sequence[int]) -> Spots:
    """Returns spots at the places from which these pictures look as captured."""
    misfits, weights = [], spots.seen.astype(np.float64)
    for moved in BESIDE:
        there = replace(spots, place=spots.place + moved)
        misfit = even_misfits(
            seen, table, Windows.around(there, np.zeros(len(there.seen)), seen.order.projector), pictures
        )
        outside = np.any((there.place < -1) | (there.place > seen.order.projector), axis=1)
        around = averaged(misfit, weights, seen.camera, SPREAD)
        misfits.append(np.where(outside, np.inf, around) if moved.any() else around)
    misfits[0] *= CLEARLY
    return replace(spots, place=spots.place + BESIDE[np.argmin(misfits, axis=0)])


def even_misfits(seen: Seen, table: Table, windows: Windows, pictures: Sequence[int], far: float = 0.0) -> FloatArray:
    """Returns the squared misfit of a Gaussian plus even far light, (camera pixels,); 0 for pixels without a window.

    far : share of far light.
    """
    misfits = np.zeros(len(seen.light))
    one = np.array([table[seen.codes[picture], np.arange(3)].mean(axis=0) for picture in pictures])
    for part in some(windows.pixel, 4 * len(pictures) * windows.size):
        here = windows.of(part)
        A = seen.drive(table, seen.mixture[here.pixel], here.columns, pictures)
        target, sigma = seen.targets(here.pixel, pictures)
        pedestal = np.einsum("pl,nkl->npk", one, seen.mixture[here.pixel]).reshape(target.shape)
        off = (1 - far) * np.einsum("new,nw->ne", A, here.start) + far * pedestal - target
        misfits[here.pixel] = (off**2 / sigma**2).sum(axis=1) / (1 / sigma**2).sum(axis=1)
    return misfits
