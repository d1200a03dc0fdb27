"""Which clusters are inverted whole and which through windows, and why."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.tools.clusters.components import Clusters

# Projector pixels of a cluster that is inverted whole. Damped, windows are faster beyond (2475 pixels: 33 s whole, 7 s
# in windows); undamped, there are no windows, and a block of the limit costs minutes.
LARGEST_DENSE, LARGEST_PLAIN = 1000, 4000
LEAST_DAMPING = 1e-5  # λ/σ₁ of windows: below, their normal equations would leave fewer than six digits
LARGEST_BLOCK = 1 << 24  # camera times projector pixels of a cluster inverted whole: 128 MiB, at work ten times that


@dataclass(frozen=True)
class Method:
    """windowed : (clusters,) bool, inverted through windows.  reason : in words, for a person."""

    windowed: NDArray[np.bool_]
    reason: str

    @property
    def name(self) -> str:
        return "windowed" if self.windowed.any() else "clustered"

    def __str__(self) -> str:
        return f"{self.name}: {self.reason}"


def choose_method(clusters: Clusters, asked: str, damping: float | None) -> Method:
    """Clusters are inverted whole as far as time and memory allow, and through windows beyond.

    asked : of INVERSE_METHODS; `clustered` and `windowed` do so with all clusters.
    damping : λ/σ₁, None if to be chosen.
    Raises InputError where windows would be needed for an (almost) undamped inverse, whose rows do not decay.
    """
    damped = damping is None or damping >= LEAST_DAMPING
    if asked == "clustered":
        return Method(np.zeros(clusters.count, bool), "as asked")
    most = LARGEST_DENSE if damped else LARGEST_PLAIN
    wide = clusters.projector_sizes > most
    heavy = clusters.projector_sizes * clusters.camera_sizes > LARGEST_BLOCK
    windowed = np.ones(clusters.count, bool) if asked == "windowed" else wide | heavy
    if windowed.any() and not damped:
        size = int(clusters.projector_sizes[windowed].max())
        raise InputError(
            f"undamped inverse: a cluster of {size} projector pixels needs windows, and those need damping (at most "
            f"{LARGEST_PLAIN} pixels, or {LARGEST_BLOCK >> 20} million entries, are inverted whole without); use "
            f"--regularize auto, a number from {LEAST_DAMPING:g}, or cut smaller clusters with --max-cluster"
        )
    if asked == "windowed":
        return Method(windowed, "as asked")
    limit = f"the {_grouped(most)} inverted whole"
    if wide.any():
        return Method(windowed, f"{_which(clusters, wide)} beyond {limit}")
    if heavy.any():
        entries = f"the {LARGEST_BLOCK >> 20} million entries inverted whole"
        return Method(windowed, f"{_which(clusters, heavy)} with its camera pixels beyond {entries}")
    largest = _grouped(int(clusters.projector_sizes.max(initial=0)))
    which = f"the largest of {_grouped(clusters.count)} clusters has {largest} projector pixels"
    return Method(windowed, f"{which}, within {limit}")


def _which(clusters: Clusters, chosen: NDArray[np.bool_]) -> str:
    count, largest = int(chosen.sum()), _grouped(int(clusters.projector_sizes[chosen].max()))
    if count == 1:
        return f"one cluster of {largest} projector pixels is"
    return f"{_grouped(count)} of {_grouped(clusters.count)} clusters, of up to {largest} projector pixels, are"


def _grouped(number: int) -> str:
    """196608 -> 196 608."""
    return f"{number:,}".replace(",", " ")
