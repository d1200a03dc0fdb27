"""The cost of T⁺ on this machine, and the decision whether it pays (docs/size.md).

Refinement's steps improve a picture more than any inverse of equal bytes, so T⁺ may cost a minute, not an hour.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.memory import available_bytes
from counterlight.raster import Region
from counterlight.tools.clusters.components import Clusters
from counterlight.tools.inverse.memory import ENTRY_BYTES, bytes_of_windows
from counterlight.tools.inverse.rows import Truncation
from counterlight.tools.inverse.windows import WindowedChannel, plan_windows, sampled_pixels
from counterlight.tools.transport.transport import CHANNELS, Csr

MOST_SECONDS = 60.0
SHARE_OF_MEMORY = 0.5  # share of the available memory that an inverse may use
MOST_FAILING = 0.2  # largest share of the sampled windows that may exceed their tolerance
OPERATIONS_A_SECOND = 5e9  # operations per second and core for blocks inverted whole: solving, truncating, joining
SECONDS_A_CLUSTER = 10e-6  # additional time per cluster


class Objection(str):
    """The reason against an inverse, in words."""


@dataclass(frozen=True)
class Price:
    """The cost of an inverse.

    seconds : time with all cores of this machine.
    needed : bytes of memory.
    failing : share of windows that miss their tolerance.
    """

    seconds: float = 0.0
    needed: float = 0.0
    failing: float = 0.0

    def __add__(self, other: "Price") -> "Price":
        return Price(self.seconds + other.seconds, self.needed + other.needed, max(self.failing, other.failing))

    def objection(self) -> Objection | None:
        """Return the reason against this price; None if it is acceptable."""
        if self.failing > MOST_FAILING:
            return Objection(f"{100 * self.failing:.0f} % of its windows would miss their tolerance")
        if self.seconds > MOST_SECONDS:
            return Objection(f"it would take {spoken(self.seconds)}")
        if self.needed > SHARE_OF_MEMORY * available_bytes():
            return Objection(f"it would need {self.needed / 2**30:.1f} GiB")
        return None


def price_of_clusters(clusters: Clusters, chosen: NDArray[np.bool_]) -> Price:
    """Return the price of clusters inverted whole, from their sizes."""
    m, n = (sizes[chosen].astype(np.float64) for sizes in (clusters.camera_sizes, clusters.projector_sizes))
    operations = len(CHANNELS) * float(np.sum(2 * m * n**2 + n**3 + 40 * m * n))
    seconds = operations / OPERATIONS_A_SECOND + SECONDS_A_CLUSTER * m.size
    return Price(seconds / _cores())


def price_of_windows(
    T: Csr,
    damping: float,
    prior: Csr | None,
    member: NDArray[np.bool_],
    truncation: Truncation,
    tolerance: float,
    regions: Sequence[Region],
) -> Price:
    """Return the price of large clusters inverted through windows, from a few sampled windows.

    T : one channel, which represents all three. Only the rows that the samples touch are used.
    """
    at_work = bytes_of_windows(T, int(np.count_nonzero(member)))
    if at_work > SHARE_OF_MEMORY * available_bytes():
        return Price(needed=at_work)
    touched = np.zeros(T.shape[0], bool) if len(regions) <= 1 else np.ones(T.shape[0], bool)
    columns = np.zeros(T.shape[1], bool)
    columns[sampled_pixels(member)] = True
    touched[np.repeat(np.arange(T.shape[0]), np.diff(T.indptr))[columns[T.indices]]] = True
    local = Csr(_only_rows(T, touched))
    channel = WindowedChannel(local, damping, prior, int(np.count_nonzero(np.diff(T.indptr))))
    sampled = plan_windows(channel, member, tolerance, regions, truncation)
    needed = ENTRY_BYTES * sampled.entries + at_work
    return Price(sampled.seconds / _cores(), needed, sampled.failing)


def spoken(seconds: float) -> str:
    """Format a duration for the user."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _only_rows(T: Csr, chosen: NDArray[np.bool_]) -> Csr:
    """Return T with only the chosen rows; the others are empty."""
    lengths = np.diff(T.indptr)
    kept = np.repeat(chosen, lengths)
    starts = np.concatenate([[0], np.cumsum(np.where(chosen, lengths, 0))])
    return Csr((T.data[kept], T.indices[kept], starts), shape=T.shape)


def _cores() -> int:
    return os.cpu_count() or 1
