"""Chooses the clusters to invert whole and the clusters to invert through windows, with the reason."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.tools.clusters.components import Clusters

# Largest cluster that is inverted whole, in projector pixels. With damping, windows are faster for larger clusters
# (2475 pixels: 33 s whole, 7 s in windows). Without damping, windows do not work, and a block of the limit takes
# minutes.
LARGEST_DENSE, LARGEST_PLAIN = 1000, 4000
LEAST_DAMPING = 1e-5  # smallest λ/σ₁ for windows; below it, their normal equations would leave fewer than six digits
# camera times projector pixels of a cluster inverted whole: 128 MiB, ten times as much during work
LARGEST_BLOCK = 1 << 24


@dataclass(frozen=True)
class Method:
    """The chosen method.

    windowed : (clusters,) bool. Inverted through windows.
    reason : reason in words, for the user.
    """

    windowed: NDArray[np.bool_]
    reason: str

    @property
    def name(self) -> str:
        return "windowed" if self.windowed.any() else "clustered"

    def __str__(self) -> str:
        return f"{self.name}: {self.reason}"


def choose_method(clusters: Clusters, damping: float | None) -> Method:
    """Invert clusters whole as far as time and memory allow, and larger ones through windows.

    damping : λ/σ₁; None if it will be chosen.

    Raises InputError if an (almost) undamped inverse would need windows: its rows do not decay.
    """
    damped = damping is None or damping >= LEAST_DAMPING
    most = LARGEST_DENSE if damped else LARGEST_PLAIN
    wide = clusters.projector_sizes > most
    heavy = clusters.projector_sizes * clusters.camera_sizes > LARGEST_BLOCK
    windowed = wide | heavy
    if windowed.any() and not damped:
        size = int(clusters.projector_sizes[windowed].max())
        raise InputError(
            f"undamped inverse: a cluster of {size} projector pixels needs windows, and those need damping (at most "
            f"{LARGEST_PLAIN} pixels, or {LARGEST_BLOCK >> 20} million entries, are inverted whole without); use "
            f"--regularize auto, a number from {LEAST_DAMPING:g}, or cut smaller clusters with --max-cluster"
        )
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
    """Group digits: 196608 -> 196 608."""
    return f"{number:,}".replace(",", " ")
