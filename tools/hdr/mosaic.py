"""A sensor's mosaic of colours into pixels: each cell becomes one, each of its colours the mean of the sites with it.

A site has one colour, and demosaicing guesses the two others from its neighbours: noise becomes patterns, and edges
colours. Here every value was measured, and neighbours share no noise. With a Bayer filter a cell is 2x2 (a red, a blue,
two greens), with X-Trans 3x3. What that costs is pixels, of which such cameras have more than a projector.

    code = 65535 (site − black) / (white − black), clipped to 0..65535

One clipped site clips its colour in the cell.
"""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray

TOP = 65535
CELLS = {2: 2, 6: 3}  # the smallest square that has every colour, by the period of the mosaic


def binned(
    sites: NDArray[np.unsignedinteger], colours: NDArray[np.intp], black: FloatArray, white: float
) -> NDArray[np.uint16]:
    """(height, width, 3) of a mosaic; incomplete periods at its right and lower edge are left out.

    colours : (period, period), 0 red, 1 green, 2 blue; the period is one of CELLS.  black : (period, period), levels.
    """
    period, cell = len(colours), CELLS[len(colours)]
    repeat = period // cell  # cells before the mosaic repeats
    height, width = (side // period * repeat for side in sites.shape)
    light: NDArray[np.float32] = np.zeros((height, width, 3), np.float32)
    clipped = np.zeros(light.shape, np.bool_)
    counts = np.zeros((repeat, repeat, 3), np.float32)
    for y, x in np.ndindex(colours.shape):
        alike = sites[y::period, x::period][: height // repeat, : width // repeat]
        place = np.s_[y // cell :: repeat, x // cell :: repeat, colours[y, x]]
        light[place] += _light(alike, float(black[y, x]), white)
        clipped[place] |= alike >= white
        counts[y // cell, x // cell, colours[y, x]] += 1
    for y, x in np.ndindex(repeat, repeat):
        light[y::repeat, x::repeat] /= counts[y, x]
    return _codes(light, clipped)


def grey(sites: NDArray[np.unsignedinteger], black: float, white: float) -> NDArray[np.uint16]:
    """(height, width) of a sensor without a mosaic, each site a pixel."""
    return _codes(_light(sites, black, white), sites >= white)


def _light(sites: NDArray[np.unsignedinteger], black: float, white: float) -> NDArray[np.float32]:
    return (sites.astype(np.float32) - np.float32(black)) * np.float32(TOP / (white - black))


def _codes(light: NDArray[np.float32], clipped: NDArray[np.bool_]) -> NDArray[np.uint16]:
    light[clipped] = TOP
    return np.asarray(np.rint(light.clip(0, TOP)), np.uint16)
