"""Bin a sensor's colour mosaic into pixels: each cell becomes one pixel, each colour the mean of its sites.

A site has one colour. Demosaicing guesses the two others from neighbours, which turns noise into patterns and edges
into colours. Here each value is measured, and neighbours share no noise. A cell is 2x2 for a Bayer filter (one red, one
blue, two greens) and 3x3 for X-Trans. The price is resolution, of which such cameras have more than a projector.

    code = 65535 (site − black) / (white − black), clipped to 0..65535

One clipped site clips its colour in the cell.
"""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray

TOP = 65535
CELLS = {2: 2, 6: 3}  # period of the mosaic: side of the smallest square that contains every colour


def binned(
    sites: NDArray[np.unsignedinteger], colours: NDArray[np.intp], black: FloatArray, white: float
) -> NDArray[np.uint16]:
    """Returns (height, width, 3) of a mosaic; incomplete periods at its right and lower edge are left out.

    colours : (period, period). 0 red, 1 green, 2 blue; the period is a key of CELLS.
    black : (period, period). Black levels.
    """
    period, cell = len(colours), CELLS[len(colours)]
    repeat = period // cell  # cells per period of the mosaic
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
    """Returns (height, width) of a sensor without a mosaic, one pixel per site."""
    return _codes(_light(sites, black, white), sites >= white)


def _light(sites: NDArray[np.unsignedinteger], black: float, white: float) -> NDArray[np.float32]:
    return (sites.astype(np.float32) - np.float32(black)) * np.float32(TOP / (white - black))


def _codes(light: NDArray[np.float32], clipped: NDArray[np.bool_]) -> NDArray[np.uint16]:
    light[clipped] = TOP
    return np.asarray(np.rint(light.clip(0, TOP)), np.uint16)
