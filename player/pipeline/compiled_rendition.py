"""What becomes of decoded light where a medium is HDR or has wide primaries, compiled; see rendition.py."""

from typing import Any

import numba
import numpy as np

from counterlight.pipeline.colour import LUMINANCE
from counterlight.pipeline.compiled import LINE, PLANE, Picture, inlined, kernel, looked_up, within
from counterlight.pipeline.rendition import LEAST, LUMINANCE_2020

ZERO, ONE, SMALL = np.float32(0), np.float32(1), np.float32(LEAST)
RED, GREEN, BLUE = (np.float32(weight) for weight in LUMINANCE)
RED_2020, GREEN_2020, BLUE_2020 = (np.float32(weight) for weight in LUMINANCE_2020)


@kernel(f"{PLANE}, float32, float32, {LINE}, {PLANE}")
def on_screen(light: Picture, ootf: Any, top: Any, gain: Picture, matrix: Picture) -> None:
    """Light of a medium -> light on the screen, in place (Rendition.on_screen).  light : (pixels, 3)."""
    for i in numba.prange(light.shape[0]):
        r, g, b = light[i, 0], light[i, 1], light[i, 2]
        share = ONE
        if ootf != ZERO:
            share = max(RED_2020 * r + GREEN_2020 * g + BLUE_2020 * b, SMALL) ** ootf
        brightest = share * max(max(r, g), b)
        share *= looked_up(gain, np.sqrt(np.sqrt(within(brightest / top, ZERO, ONE)))) * top / max(brightest, top)
        r, g, b = share * r, share * g, share * b
        light[i, 0], light[i, 1], light[i, 2] = _within_gamut(
            matrix[0, 0] * r + matrix[0, 1] * g + matrix[0, 2] * b,
            matrix[1, 0] * r + matrix[1, 1] * g + matrix[1, 2] * b,
            matrix[2, 0] * r + matrix[2, 1] * g + matrix[2, 2] * b,
        )


@inlined
def _within_gamut(r: Any, g: Any, b: Any) -> Any:
    grey = within(RED * r + GREEN * g + BLUE * b, ZERO, ONE)
    least, most = min(min(r, g), b), max(max(r, g), b)
    share = ONE
    if least < ZERO:
        share = grey / max(grey - least, SMALL)
    if most > ONE:
        share = min(share, (ONE - grey) / max(most - grey, SMALL))
    return (
        within(grey + share * (r - grey), ZERO, ONE),
        within(grey + share * (g - grey), ZERO, ONE),
        within(grey + share * (b - grey), ZERO, ONE),
    )
