"""Checks that the pixels of an imported T are numbered as its sizes say: row by row, from the upper left.

A matrix does not state its pictures' widths, and width and height are easily swapped. With the right sizes, two
vertically adjacent pixels exchange light with nearby places; with swapped sizes, with distant places.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import Csr

Shape: TypeAlias = tuple[int, int]
Reading: TypeAlias = tuple[Shape, Shape]  # camera and projector, (height, width) each

# `python -m tests.studies.pixel_order` compares the roughness for the given sizes with that for a smooth other reading.
# Right sizes: at most 1.2 times as rough, in 100 random rooms of each of 32 kinds; the shipped scenes have no smooth
# other reading. Swapped sizes: 2.0 to 67 times, in the shipped scenes from 12x9 pixels on.
ROUGHER = 2.0
SMOOTH = 0.25  # roughness; shipped scenes have at most 0.22 from 12x9 pixels on, random numbers 0.8 to 1.3
LEAST_SIDE = 8  # pixels; in smaller pictures, one row is a large part of the height
LEAST_PAIRS = 8
LIT = 0.01  # light of a lit pixel, as a share of the floodlight's 99th percentile


@dataclass(frozen=True)
class Misreading:
    """The given sizes, for which T is rough, and swapped sizes, for which T is smooth.

    roughness : roughness of both readings, a median distance (`_roughness`).
    """

    given: Reading
    smooth: Reading
    roughness: tuple[float, float]

    def described(self, size: Callable[[Shape], str]) -> str:
        """Describe both readings in words; `size` formats one (height, width)."""
        (rough, fine), given, smooth = (
            self.roughness,
            *(
                f"camera {size(camera)} and projector {size(projector)}"
                for camera, projector in (self.given, self.smooth)
            ),
        )
        return (
            f"T looks scrambled for {given}, where neighbouring pixels' light is {rough:.2f} of a random distance "
            f"apart, and smooth for {smooth}, {fine:.2f}"
        )


def misreading(near: SparseRows, camera: Shape, projector: Shape) -> Misreading | None:
    """Look for swapped sizes; None if T is not smoother for them, or has too few pixels to tell.

    near : (camera pixels, projector pixels), before it is factored.
    camera, projector : (height, width).

    Square pictures cannot be distinguished from their transposes.
    """
    if min(*camera, *projector) < LEAST_SIDE:
        return None
    found, given = roughnesses(near, camera, projector), (camera, projector)
    smooth = min(found, key=lambda each: found[each])
    if found[smooth] <= SMOOTH and ROUGHER * found[smooth] < found[given] < np.inf:
        return Misreading(given, smooth, (found[given], found[smooth]))
    return None


def roughnesses(near: SparseRows, camera: Shape, projector: Shape) -> dict[Reading, float]:
    """Return the roughness of T for the given sizes, which come first, and for swapped ones; infinite if unknown."""
    weights = near.weights.sum(axis=1, dtype=np.float32)
    weights /= max(float(weights.max(initial=0.0)), 1e-30)  # squares stay within float32 in any unit
    T = Csr((weights, near.indices, near.indptr), shape=near.shape)
    # direct light outweighs indirect light
    squares = Csr((weights * weights, near.indices, near.indptr), shape=near.shape)
    cameras, projectors = _Side(T, squares), _Side(Csr(T.T), Csr(squares.T))
    return {
        (c, p): max(cameras.roughness(c, camera, p), projectors.roughness(p, projector, c))
        for c in _orders(camera)
        for p in _orders(projector)
    }


def _orders(shape: Shape) -> list[Shape]:
    """Return a picture's size and, unless it is square, the swapped size."""
    return list(dict.fromkeys([shape, shape[::-1]]))


class _Side:
    """The pixels of one device, and the places on the other device that they exchange light with."""

    def __init__(self, T: Csr, squares: Csr) -> None:
        """Prepare one side.

        T : (pixels of this device, pixels of the other).
        squares : T with squared entries.
        """
        light = np.asarray(T.sum(axis=1))
        self._lit: BoolArray = light > LIT * np.percentile(light, 99)
        self._squares, self._sums = squares, np.maximum(squares.sum(axis=1), 1e-30)
        lit = np.flatnonzero(self._lit)
        self._random = np.random.default_rng(0).permutation(lit), lit

    def roughness(self, shape: Shape, given: Shape, other: Shape) -> float:
        """Return the median distance between vertical neighbours' light on the other device, relative to random pixels.

        shape : this device's reading.
        given : the reading that the caller named.
        other : the other device's reading.

        The result is the larger of two medians: of vertical neighbours, and of horizontal neighbours between which a
        row of the swapped reading ends. It is infinite for too few lit pairs; `given` may lack the second median.
        """
        places, pixels = self._places(other), np.arange(self._lit.size)
        distances = [self._median(places, pixels[: -shape[1]], pixels[shape[1] :])]
        if shape[0] != shape[1]:
            begins = pixels[shape[0] :: shape[0]]
            within = begins[begins % shape[1] > 0]
            across = self._median(places, within - 1, within)
            if shape != given or across < np.inf:
                distances.append(across)
        at_random = self._median(places, *self._random)
        return max(distances) / at_random if 0 < at_random < np.inf else np.inf

    def _places(self, other: Shape) -> FloatArray:
        """Return the centre of each pixel's light on the other device, (pixels, 2), in pixels."""
        rows_columns = np.stack(np.divmod(np.arange(other[0] * other[1]), other[1]), axis=1).astype(np.float32)
        return np.asarray(self._squares @ rows_columns / self._sums[:, None], np.float64)

    def _median(self, places: FloatArray, first: IntArray, second: IntArray) -> float:
        """Return the median distance between pairs of lit pixels; infinite for too few pairs."""
        both: NDArray[np.bool_] = self._lit[first] & self._lit[second]
        if both.sum() < LEAST_PAIRS:
            return np.inf
        return float(np.median(np.linalg.norm(places[first[both]] - places[second[both]], axis=1)))
