"""Decide whether rows of T are too long for maps, and replace them by blocks of pixels."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from counterlight import memory
from counterlight.maps.row_map import SparseRows, below_each_other
from counterlight.tools.blurring.choice import chosen_limit
from counterlight.tools.blurring.pruning import Pyramid, in_cells
from counterlight.tools.transport.transport import Transport

LONG, MANY = 64, 1 << 24  # entries per camera pixel and in total; below either, T is played unchanged
BAND = 1 << 22  # entries that are put into cells at a time
BYTES_AN_ENTRY = 16  # a second T, in bands that wait for the last band
LEAST_SAVED = 0.5  # share of T's entries that may remain; otherwise T stays unchanged


@dataclass(frozen=True)
class Blurring:
    """The result of blurring.

    before : entries per channel at first.
    near, blurred : near and blurred entries per channel now.
    losses : dB by the names of pictures.
    """

    before: int
    near: int
    blurred: int
    losses: dict[str, float]

    def __str__(self) -> str:
        lost = ", ".join(f"{name} {loss:.3f}" for name, loss in self.losses.items())
        return (
            f"blurred light in blocks of pixels: {self.before} entries a channel are {self.near} near and "
            f"{self.blurred} blurred ones; where blur is widest pictures lose, in dB: {lost}"
        )


def too_long(entries: int, rows: int) -> bool:
    """Whether so many entries in so many rows are too many for maps."""
    return entries > max(LONG * rows, MANY)


def in_blocks(transport: Transport, tolerance: float) -> tuple[Transport, Blurring | None]:
    """Replace rows that are too long: S + U M D → S + B P + U M D; returns T unchanged and None if not worthwhile.

    transport : T with its pictures' sizes.
    tolerance : dB that a compensated picture may lose. Far light is ignored, which never underestimates the loss.

    Raises InputError if memory does not suffice.
    """
    near, camera, raster = transport.near, transport.camera, transport.projector
    assert camera is not None
    assert raster is not None
    if tolerance <= 0 or transport.blurred is not None or not too_long(near.indices.size, near.shape[0]):
        return transport, None
    needed = BYTES_AN_ENTRY * near.indices.size
    memory.check(needed, "putting blurred light into blocks", "close other programs, or keep T with --tolerance 0")
    choice = chosen_limit([near], camera[1], raster, tolerance)
    if not choice.limit:
        return transport, None
    parts = [in_cells(band, raster, choice.limit) for band in _bands(near)]
    sharp, scatter = (below_each_other(list(each)) for each in zip(*parts, strict=True))
    if sharp.indices.size + scatter.indices.size > LEAST_SAVED * near.indices.size:
        return transport, None
    done = Blurring(near.indices.size, sharp.indices.size, scatter.indices.size, choice.losses)
    return replace(transport, near=sharp, blurred=Pyramid(raster).light(scatter)), done


def _bands(rows: SparseRows) -> Iterator[SparseRows]:
    """Yield consecutive rows with about BAND entries at a time."""
    count = rows.shape[0]
    starts = np.unique(np.searchsorted(rows.indptr, np.arange(0, rows.indices.size, BAND)).clip(0, count))
    for first, end in zip(starts, [*starts[1:], count], strict=True):
        yield rows.at(np.arange(first, end))
