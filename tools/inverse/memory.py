"""Memory that an inverse needs, checked before the work starts.

Every need is an upper estimate; peaks were measured with tracemalloc.
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

# bytes per entry of a block inverted whole: three channels, their inverses, the arrays that truncation sorts
WORK_BYTES = 24 * 8
ENTRY_BYTES = 70  # bytes per entry of T⁺: pieces, joined rows, the packed texture (58 measured, without far light)
NORMAL_BYTES = 3 * 40  # bytes per entry of TᵀT: its three channels while they are added up
ROOM_BYTES, PIXEL_BYTES = 250, 400  # bytes while a room's maps are made: per entry of T, and per pixel of both sides
BLURRED_BYTES = 120  # per entry of B, which has neither T⁺ nor words
IN_ONE_BYTES = 150  # bytes per entry of a T that is made dense and cut: its rows, its graph and the graph's order
FORETELLING_SHARE = 0.02  # share of the rows that is computed to predict the entries of all rows, to within 15 %
SAMPLE_COLUMNS = 64


def check_choice(projector_pixels: int) -> None:
    """Check memory before λ is chosen: one Krylov basis per picture at work."""
    needed = min(PICTURES, os.cpu_count() or 1) * bytes_of_basis(MOST_STEPS, projector_pixels)
    check(needed, "choosing λ", "name it instead, such as --regularize 0.03")


def check_whole(clusters: Clusters, whole: NDArray[np.bool_]) -> None:
    """Check memory before clusters are inverted whole: the largest ones at the same time, one per core."""
    entries = np.sort((clusters.camera_sizes * clusters.projector_sizes)[whole])[-(os.cpu_count() or 1) :]
    if entries.size:
        largest = int(clusters.projector_sizes[whole].max())
        what = f"inverting clusters of up to {largest} projector pixels whole"
        check(WORK_BYTES * float(entries.sum()), what, "use --inverse cut with a smaller --max-cluster")


def check_windows(T: Csr, projector_pixels: int) -> None:
    """Check memory before windows are inverted.

    T : one channel.
    projector_pixels : pixels of the clusters.
    """
    remedy = "use --inverse cut or none, or leave the option out"
    check(bytes_of_windows(T, projector_pixels), "inverting large clusters through windows", remedy)


def bytes_of_windows(T: Csr, projector_pixels: int) -> float:
    """Return the memory of windows at work: TᵀT of three channels, and the widest window on each core."""
    window = min((BLOCKS[0] + 2 * HALOS[-1]) ** 2, projector_pixels)
    return NORMAL_BYTES * normal_entries(T) + (os.cpu_count() or 1) * 2 * 8 * window**2


def check_room(near: int, blurred: int, pixels: int) -> None:
    """Check the minimum memory before any work.

    near, blurred : entries of S and B per channel.
    pixels : pixels of camera and projector together.
    """
    needed = ROOM_BYTES * float(near) + BLURRED_BYTES * float(blurred) + PIXEL_BYTES * float(pixels)
    what = f"a room of {(near + blurred) / 1e6:.0f} million entries"
    check(needed, what, "use --no-refine, or a smaller camera or projector")


def check_in_one(camera_pixels: int, projector_pixels: int) -> None:
    """Check memory before near and far light become one (almost) dense T."""
    what = f"near and far light in one T, of {camera_pixels}x{projector_pixels} entries,"
    remedy = "give --tau, or use a smaller camera or projector"
    check(IN_ONE_BYTES * float(camera_pixels) * projector_pixels, what, remedy)


def normal_entries(T: Csr) -> float:
    """Estimate the entries of TᵀT from evenly spaced columns."""
    lit = np.flatnonzero(np.bincount(T.indices))
    chosen = lit[np.linspace(0, lit.size - 1, min(SAMPLE_COLUMNS, lit.size)).astype(int)]
    sampled: Csr = T.T @ T[:, chosen]
    return float(int(sampled.nnz) / chosen.size * lit.size)


def checked_as_they_come(pieces: Iterable[Piece], whole: int, windowed: int, entry_bytes: float) -> Iterator[Piece]:
    """Pass on pieces of T⁺; at 2 %, 4 %, 8 % … of the rows, predict the total entries, and refuse what cannot fit.

    Whole clusters and windows are predicted separately. In large rooms with many clusters of one or two pixels, most
    rows have few entries, and most entries belong to windows.

    pieces : in mixed order, so that the first few are a fair sample of all.
    whole, windowed : number of rows of each kind.
    entry_bytes : memory per entry of T⁺.
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
