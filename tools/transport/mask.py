"""Finds the camera pixels that count: those that the projector lights clearly (mask.png)."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.passes.colour import LUMINANCE
from counterlight.pipeline.content import BRIGHT_PERCENTILE, FRACTION_OF_BRIGHT
from counterlight.tools.transport.transport import Transport
from counterlight.tools.transport.trust import CUT, cut_by_edges

DARK_PAINT = 0.01  # share of the bright pixels' near light, where far light cannot be mistaken for it
FRACTION_OF_AMBIENT = 0.02
CLEAR = 5.0  # least rise of a lit pixel, in multiples of the noise


def directly_lit(
    transport: Transport,
    ambient: NDArray[np.floating],
    projector: tuple[int, int],
    noise: FloatArray | None = None,
) -> NDArray[np.bool_]:
    """Return camera pixels that count without their far light, and whose footprints are not cut by the raster's edge.

    ambient : (height, width, 3).
    projector : (height, width).
    noise : as in `lit_pixels`.
    """
    near = transport.without_far.composition().reshape(ambient.shape)
    lit, camera = lit_pixels(near, ambient, noise, DARK_PAINT), (ambient.shape[0], ambient.shape[1])
    whole = lit & (cut_by_edges(transport, camera, projector) < CUT).reshape(camera)
    return whole if whole.any() else lit


def lit_pixels(
    composition: NDArray[np.floating],
    ambient: NDArray[np.floating],
    noise: FloatArray | None = None,
    share: float = FRACTION_OF_BRIGHT,
) -> NDArray[np.bool_]:
    """Return the camera pixels that white floodlight raises clearly above ambient.

    With y the luminance of T·1, a of e and n of the noise, a pixel is lit if y ≥ max(share · y₉₉, 0.02 · a, 5 n) and y
    > 0. y₉₉ is the 99th percentile of the pixels that rise at all, so neither a highlight nor the dark part of the view
    affects it.

    - 5 % of the bright pixels excludes stray light and the dimmer far light outside the projector's beam. Brighter far
      light (a white room) cannot be distinguished from direct light by its level. If the near part of T is known, pass
      its composition and 1 %, which keeps dark paint and ink (3 to 5 % of white paper).
    - 2 % of ambient is the flicker of a lamp, or the noise of a camera whose noise was not measured; a smaller rise is
      no measurement.

    composition : (height, width, 3). T·1, without ambient light.
    ambient : (height, width, 3). e, in the same unit.
    noise : (3,). Standard deviation of a pixel's rise from black to floodlight; None if not measured.
    share : least light, as a share of the bright pixels' light.

    Returns (height, width) bool; all False if nothing rises.
    """
    rise, background = np.asarray(composition) @ LUMINANCE, np.asarray(ambient) @ LUMINANCE
    positive = rise[rise > 0]
    if not positive.size:
        return np.zeros(rise.shape, np.bool_)
    bright = np.percentile(positive, BRIGHT_PERCENTILE)
    least = 0.0 if noise is None else CLEAR * float(np.linalg.norm(LUMINANCE * noise))
    threshold = np.maximum(max(share * bright, least), FRACTION_OF_AMBIENT * background)
    return np.asarray((rise > 0) & (rise >= threshold))
