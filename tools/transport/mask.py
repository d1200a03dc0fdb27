"""Which camera pixels count: those that the projector lights clearly (mask.png)."""

import numpy as np
from numpy.typing import NDArray

from counterlight.pipeline.colour import LUMINANCE
from counterlight.tools.transport.transport import Transport

BRIGHT_PERCENTILE = 99.0
FRACTION_OF_BRIGHT = 0.05
FRACTION_OF_AMBIENT = 0.02


def directly_lit(transport: Transport, ambient: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Camera pixels that count by their near light alone; ambient : (height, width, 3)."""
    return lit_pixels(transport.near.sums().reshape(ambient.shape), ambient)


def lit_pixels(composition: NDArray[np.floating], ambient: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Camera pixels that white floodlight raises clearly above ambient.

    With y the luminance of T·1 and a that of e, a pixel is lit if y ≥ max(0.05 · y₉₉, 0.02 · a), y > 0, where y₉₉ is
    the 99th percentile of the pixels that rise at all: neither a highlight moves it, nor how much of the view is dark.

    - 5 % of the bright pixels keeps dark ink (about 4 to 5 % of white paper) and drops a camera's noise floor, stray
      light and the dimmer far light outside the projector's beam. Far light brighter than that (a white room) is not
      told from direct light by its level: where the near part of T is known apart, pass its composition alone.
    - 2 % of ambient is what a camera's noise and a lamp's flicker reach; a smaller rise is no measurement.

    composition : (height, width, 3), T·1, without ambient light.  ambient : (height, width, 3), e, the same unit.
    Returns (height, width) bool; all False if nothing rises.
    """
    rise, background = np.asarray(composition) @ LUMINANCE, np.asarray(ambient) @ LUMINANCE
    positive = rise[rise > 0]
    if not positive.size:
        return np.zeros(rise.shape, np.bool_)
    bright = np.percentile(positive, BRIGHT_PERCENTILE)
    threshold = np.maximum(FRACTION_OF_BRIGHT * bright, FRACTION_OF_AMBIENT * background)
    return np.asarray((rise > 0) & (rise >= threshold))
