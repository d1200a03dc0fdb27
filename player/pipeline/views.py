"""The views, and the colours and scales of the views that are maps.

error : predicted camera picture minus target, of the worst channel, in shares of white. Blue is too dark, red is too
    bright, with full colour at ERROR_SPAN and beyond; near-black pixels do not count.
impossible : camera pixels that cannot be corrected. The colour shows which grey level full drive cannot reach. If
    several classes apply, the first one is shown.
clipping : drawn over a view. It shows targets beyond the possible range: red above, blue below, half strength from
    CLIP_FAINT on, and full strength at CLIP_SPAN. In the projector's view this is T⁺ b beyond 0..1. In the camera's
    view it is near light below 0 or above full drive, in shares of white, after ambient and far light are subtracted.
"""

import numpy as np
from numpy.typing import NDArray

from counterlight.response import Response

VIEWS = ("projector", "camera", "split", "error", "impossible")
ERROR_SPAN = 0.2
CLIP_FAINT, CLIP_SPAN = 0.02, 0.25
MID_GREY = 0.5  # share of white, in linear light
SLACK = 1e-6  # relative tolerance, because T is float32

# Colours of the views that are maps, 8-bit sRGB.
SERVED, UNLIT, BELOW_MID_GREY, BELOW_WHITE = (205, 205, 205), (40, 40, 40), (213, 60, 50), (240, 160, 60)
TOO_MUCH, TOO_LITTLE = (213, 60, 50), (70, 130, 220)
TOO_DARK, RIGHT, TOO_BRIGHT = (59, 76, 192), (221, 221, 221), (180, 4, 38)
ERROR_SAMPLES = 513
LEGENDS = {
    "error": (
        (TOO_DARK, f"too dark by {ERROR_SPAN:.0%} of white or more"),
        (RIGHT, "as it was asked for"),
        (TOO_BRIGHT, f"too bright by {ERROR_SPAN:.0%} of white or more"),
        (UNLIT, "does not count"),
    ),
    "impossible": (
        (SERVED, "can be as bright as white"),
        (BELOW_WHITE, "cannot be white"),
        (BELOW_MID_GREY, "cannot be mid grey"),
        (UNLIT, "does not count"),
    ),
}
CLIPPING_LEGEND = (TOO_MUCH, "asked for beyond full light"), (TOO_LITTLE, "asked for below none")


def linear(colour: tuple[int, int, int]) -> NDArray[np.float64]:
    """Convert 8-bit sRGB to linear light, (3,)."""
    return Response("srgb").to_linear(np.array(colour) / 255)


IMPOSSIBLE = np.stack([linear(colour) for colour in (SERVED, UNLIT, BELOW_MID_GREY, BELOW_WHITE)])
UNCOUNTED = linear(UNLIT)
OVER, UNDER = linear(TOO_MUCH), linear(TOO_LITTLE)


def error_colours() -> NDArray[np.float64]:
    """Return linear light over errors from −ERROR_SPAN to ERROR_SPAN, even in code values: (ERROR_SAMPLES, 3)."""
    ends, grid = np.array([TOO_DARK, RIGHT, TOO_BRIGHT]) / 255, np.linspace(0, 1, ERROR_SAMPLES)
    codes = np.stack([np.interp(grid, [0, 0.5, 1], ends[:, i]) for i in range(3)], axis=-1)
    return Response("srgb").to_linear(codes)
