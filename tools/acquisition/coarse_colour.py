"""Correct the colours of T that a camera with 8 bits has measured.

JPEG and webcams store colour at half the resolution of brightness, averaged in code values. Where bright and dark
pixels alternate, as in the finest patterns, bright pixels receive the weak colour codes of their dark neighbours. A
coloured wall is then too pale in T. A white picture has no such edges, so the rows of T are scaled to the light of
white.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

from counterlight.arrays import FloatArray
from counterlight.tools.acquisition.plan import Reference
from counterlight.tools.transport.transport import Transport

WELL_LIT = 10  # light of a well-lit pixel, in multiples of the noise of a dark capture
BLUR = 1.0  # σ in camera pixels: T has finer details of brightness than a capture of white, which JPEG rounds


def coloured_like_white(transport: Transport, room: Reference) -> Transport:
    """Scale the rows of T by F / (T·1), averaged over well-lit neighbours; F is the captured light of white."""
    white, own = room.light, transport.composition()
    lit = (np.minimum(white, own) > WELL_LIT * room.noise.dark) & ~room.saturated.reshape(-1, 1)
    ratio = np.divide(white, own, out=np.zeros_like(own), where=lit)
    share = _blurred(lit.astype(np.float64), room)
    return transport.scaled(np.divide(_blurred(ratio, room), share, out=np.ones_like(own), where=lit))


def _blurred(values: FloatArray, room: Reference) -> FloatArray:
    picture = values.reshape(room.black.shape)
    return np.asarray(gaussian_filter(picture, (BLUR, BLUR, 0))).reshape(values.shape)
