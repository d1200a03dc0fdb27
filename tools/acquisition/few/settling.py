"""Whether a place is a period off: what ramps and random pictures look like from the periods beside it."""

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
CLEARLY = 0.5  # of the misfit of the place as it is, that another one's may be


def settled(seen: Seen, table: Table, spots: Spots, pictures: Sequence[int]) -> Spots:
    """Spots at the places from which those pictures look as they did."""
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
    """By how much camera pixels with these windows saw something else than a Gaussian and even far light, squared:
    (camera pixels,), 0 for the others.

    far : the share of far light.
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
