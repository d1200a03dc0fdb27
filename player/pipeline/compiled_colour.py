"""Compiled passes from decoded codes to light on the screen; see signal.py and rendition.py."""

from typing import Any

import numba
import numpy as np

from counterlight.pipeline.colour import LUMINANCE
from counterlight.pipeline.compiled import LINE, PLANE, Picture, inlined, kernel, looked_up, within
from counterlight.pipeline.rendition import LEAST, LUMINANCE_2020

ZERO, ONE, SMALL = np.float32(0), np.float32(1), np.float32(LEAST)
RED, GREEN, BLUE = (np.float32(weight) for weight in LUMINANCE)
RED_2020, GREEN_2020, BLUE_2020 = (np.float32(weight) for weight in LUMINANCE_2020)


@kernel(f"{PLANE}, float32[:, :, :, ::1], {LINE}, {LINE}, {LINE}")
def through_table(codes: Picture, table: Picture, low: Picture, scale: Picture, transfer: Picture) -> None:
    """Apply a lookup table to codes and convert the result to light, in place (tetrahedral).

    codes : (pixels, 3). Within 0..1.
    low, scale : (3,). The position of a code in the table is (code − low) · scale.
    """
    last = np.float32(table.shape[0] - 1)
    for i in numba.prange(codes.shape[0]):
        x, r = _cell((codes[i, 0] - low[0]) * scale[0], last)
        y, g = _cell((codes[i, 1] - low[1]) * scale[1], last)
        z, b = _cell((codes[i, 2] - low[2]) * scale[2], last)
        most, least = max(max(r, g), b), min(min(r, g), b)
        middle = r + g + b - most - least
        red = r == most
        green = not red and g == most
        end_b = b == least
        end_g = not end_b and g == least
        x1, y1, z1 = x + int(red), y + int(green), z + int(not red and not green)
        x2, y2, z2 = x + int(end_b or end_g), y + int(not end_g), z + int(not end_b)
        for c in range(3):
            code = (
                (ONE - most) * table[z, y, x, c]
                + (most - middle) * table[z1, y1, x1, c]
                + (middle - least) * table[z2, y2, x2, c]
                + least * table[z + 1, y + 1, x + 1, c]
            )
            codes[i, c] = looked_up(transfer, within(code, ZERO, ONE))


@inlined
def _cell(position: Any, last: Any) -> Any:
    """Return the cell of a table along one axis, and the position within the cell, 0..1."""
    inside = within(position, ZERO, last)
    cell = min(np.int64(inside), np.int64(last) - 1)
    return cell, inside - np.float32(cell)


@kernel(f"{PLANE}, float32, float32, {LINE}, {PLANE}")
def on_screen(light: Picture, ootf: Any, top: Any, gain: Picture, matrix: Picture) -> None:
    """Convert light of a medium to light on the screen, in place (Rendition.on_screen). light : (pixels, 3)."""
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
