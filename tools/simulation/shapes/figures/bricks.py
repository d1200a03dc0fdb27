"""A brickstone wall: rough bricks in courses that are offset by half a brick, and deep mortar (thesis 6.1).

Bricks and mortar lie where the pattern "bricks" of repeat [8, 16] has them.
"""

import numpy as np

from counterlight.arrays import FloatArray

BRICKS, COURSES = 8, 16  # along u and v
MORTAR, ROUNDED = 0.08, 0.1  # course heights: width of the mortar, and width of a rounded edge
ROUGH = ((24, 0.22), (61, 0.12), (140, 0.06))  # bumps along v, and their height


def heights(u: FloatArray, v: FloatArray) -> FloatArray:
    """Returns height (…) at u, v (…) in 0..1: 0 in the mortar, 1 at the highest bump."""
    y = v * COURSES
    course = np.floor(y)
    x = u * BRICKS + 0.5 * (course % 2)
    above, right = y - course - MORTAR, (x - np.floor(x)) * COURSES / BRICKS - MORTAR  # course heights
    inside = np.minimum(np.minimum(above, 1 - MORTAR - above), np.minimum(right, COURSES / BRICKS - MORTAR - right))
    rise = np.clip(inside / ROUNDED, 0, 1)
    rough = [size * _noise(bumps * u, bumps * v, bumps) for bumps, size in ROUGH]
    face = 1 - sum(size for _, size in ROUGH) + np.sum(rough, axis=0)
    return np.asarray(face * rise * rise * (3 - 2 * rise))


def _noise(x: FloatArray, y: FloatArray, seed: int) -> FloatArray:
    """Returns smooth bumps of 0 to 1, one bump per unit."""
    column, row = np.floor(x), np.floor(y)
    across, along = (part * part * (3 - 2 * part) for part in (x - column, y - row))
    lower, upper = (
        (1 - across) * _chance(column, row + step, seed) + across * _chance(column + 1, row + step, seed)
        for step in (0, 1)
    )
    return np.asarray((1 - along) * lower + along * upper)


def _chance(column: FloatArray, row: FloatArray, seed: int) -> FloatArray:
    """Returns a number in 0..1 per place, the same on every machine."""
    mixed = column.astype(np.uint32) * np.uint32(374761393) + row.astype(np.uint32) * np.uint32(668265263)
    mixed = (mixed ^ (mixed >> np.uint32(13))) * np.uint32(1274126177) + np.uint32(seed)
    return np.asarray((mixed ^ (mixed >> np.uint32(16))) / float(1 << 32))
