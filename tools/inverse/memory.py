"""What an inverse needs of memory, asked before the work starts.

Every need is an estimate from above; peaks were measured with tracemalloc.
"""

import os
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from counterlight.memory import check
from counterlight.tools.clusters.components import Clusters
from counterlight.tools.inverse.bidiagonal import bytes_of_basis
from counterlight.tools.inverse.damping import MOST_STEPS
from counterlight.tools.inverse.pictures import PICTURES
from counterlight.tools.inverse.rows import Piece
from counterlight.tools.inverse.windows import BLOCKS, HALOS
from counterlight.tools.transport.transport import Csr

WORK_BYTES = 24 * 8  # of a block inverted whole, per entry: three channels, their inverses, what truncation sorts
ENTRY_BYTES = 70  # of T⁺, per entry: pieces, joined rows, the packed texture (58 measured, far light apart)
NORMAL_BYTES = 3 * 40  # of TᵀT, per entry: three channels, while they are added up
ROOM_BYTES, PIXEL_BYTES = 250, 400  # of a room's maps while they are made, an entry of T, a pixel of both sides
BLURRED_BYTES = 120  # an entry of B, of which there are neither T⁺ nor words
IN_ONE_BYTES = 150  # of a T that is made dense and cut, per entry: its rows, its graph and what orders that
FORETELLING_SHARE = 0.02  # of the rows, after which the entries of all are foretold first: within 15 %
SAMPLE_COLUMNS = 64


def check_choice(projector_pixels: int) -> None:
    """Before λ is chosen: one Krylov basis for each picture at work."""
    needed = min(PICTURES, os.cpu_count() or 1) * bytes_of_basis(MOST_STEPS, projector_pixels)
    check(needed, "choosing λ", "name it instead, such as --regularize 0.03")


def check_whole(clusters: Clusters, whole: NDArray[np.bool_]) -> None:
    """Before clusters are inverted whole: the largest of them at once, one on each core."""
    entries = np.sort((clusters.camera_sizes * clusters.projector_sizes)[whole])[-(os.cpu_count() or 1) :]
    if entries.size:
        largest = int(clusters.projector_sizes[whole].max())
        what = f"inverting clusters of up to {largest} projector pixels whole"
        check(WORK_BYTES * float(entries.sum()), what, "use --method auto with damping, or a smaller --max-cluster")


def check_windows(T: Csr, projector_pixels: int) -> None:
    """Before large clusters are inverted through windows.  T : one channel.  projector_pixels : of the clusters."""
    remedy = "use --inverse cut or none, or leave the option out"
    check(bytes_of_windows(T, projector_pixels), "inverting large clusters through windows", remedy)


def bytes_of_windows(T: Csr, projector_pixels: int) -> float:
    """What windows need at work: TᵀT of three channels, and the widest window on each core."""
    window = min((BLOCKS[0] + 2 * HALOS[-1]) ** 2, projector_pixels)
    return NORMAL_BYTES * normal_entries(T) + (os.cpu_count() or 1) * 2 * 8 * window**2


def check_room(near: int, blurred: int, pixels: int) -> None:
    """Before anything: what so many entries of S and B a channel, camera and projector pixels need at the least."""
    needed = ROOM_BYTES * float(near) + BLURRED_BYTES * float(blurred) + PIXEL_BYTES * float(pixels)
    what = f"a room of {(near + blurred) / 1e6:.0f} million entries"
    check(needed, what, "use --no-refine, or a smaller camera or projector")


def check_in_one(camera_pixels: int, projector_pixels: int) -> None:
    """Before near and far light are written out in one T, (almost) dense."""
    what = f"near and far light in one T, of {camera_pixels}x{projector_pixels} entries,"
    remedy = "give --tau, or use a smaller camera or projector"
    check(IN_ONE_BYTES * float(camera_pixels) * projector_pixels, what, remedy)


def normal_entries(T: Csr) -> float:
    """Entries of TᵀT, from evenly spaced columns of it."""
    lit = np.flatnonzero(np.bincount(T.indices))
    chosen = lit[np.linspace(0, lit.size - 1, min(SAMPLE_COLUMNS, lit.size)).astype(int)]
    sampled: Csr = T.T @ T[:, chosen]
    return float(int(sampled.nnz) / chosen.size * lit.size)


def checked_as_they_come(pieces: Iterable[Piece], whole: int, windowed: int, entry_bytes: float) -> Iterator[Piece]:
    """Pass pieces on; at 2 % of the rows, 4, 8 and so on, foretell the entries of all, and refuse what cannot fit.

    Those of whole clusters and those of windows are foretold apart: in large rooms with many clusters of a pixel or
    two, most rows have a few entries and most entries are of windows.

    pieces : in an order of which every beginning is spread over them all.  whole, windowed : rows of either kind.
    entry_bytes : that an entry of T⁺ takes.
    """
    counts, rows, entries, shares = (whole, windowed), [0, 0], [0, 0], [FORETELLING_SHARE] * 2
    for piece in pieces:
        kind = piece.halo > 0
        rows[kind], entries[kind] = rows[kind] + piece.rows.size, entries[kind] + piece.columns.size
        if rows[kind] >= shares[kind] * counts[kind]:
            shares[kind] = 2 * rows[kind] / counts[kind]
            expected = sum(
                found * count / max(seen, 1) for found, count, seen in zip(entries, counts, rows, strict=True)
            )
            check(
                entry_bytes * expected - sum(entries) * 16,
                f"the correction map, of about {expected / 1e6:.0f} million entries,",
                "shorten its rows with a larger --max-error or --regularize, or use --max-cluster",
            )
        yield piece
