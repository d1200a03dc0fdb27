"""Correct the colours of T that a camera with 8 bits has measured.

JPEG and webcams store colour at half the resolution of brightness, averaged in code values. Where bright and dark
pixels alternate, as in the finest patterns, bright pixels receive the weak colour codes of their dark neighbours. A
coloured wall is then too pale in T. A white picture has no such edges, so the rows of T are scaled to the light of
white.
"""

import numpy as np

from counterlight.tools.acquisition.camera_shift import mean_around
from counterlight.tools.acquisition.plan import Reference
from counterlight.tools.acquisition.ramps import WELL_LIT
from counterlight.tools.transport.transport import Transport

BLUR = 1.0  # σ in camera pixels: T has finer details of brightness than a capture of white, which JPEG rounds


def coloured_like_white(transport: Transport, room: Reference) -> Transport:
    """Scale the rows of T by F / (T·1), averaged over well-lit neighbours; F is the captured light of white."""
    white, own = (light.reshape(room.black.shape) for light in (room.light, transport.composition()))
    lit = (np.minimum(white, own) > WELL_LIT * room.noise.dark) & ~room.saturated[..., None]
    ratio = np.divide(white, own, out=np.ones_like(own), where=lit)
    return transport.scaled(np.where(lit, mean_around(ratio, lit, BLUR), 1).reshape(-1, 3))
