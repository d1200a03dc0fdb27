"""Screen for test rooms whose camera raster is split into two cameras."""

import numpy as np

from counterlight.screen import Screen


def split_screen(camera: tuple[int, int], top: int) -> Screen:
    """Two cameras.

    The upper one, a pixel narrower, sees the screen's left part turned and smaller; the other the right.
    """
    height, width = camera
    positions = np.zeros((height, width, 2), np.float32)
    y, x = np.mgrid[:height, :width] + 0.5
    positions[:top] = np.stack([1.3 * x + 0.2 * y, 1.1 * y - 0.1 * x + 0.003 * x * y + 2], axis=-1)[:top]
    positions[top:] = np.stack([0.6 * x + 9, 0.7 * (y - top) + 1], axis=-1)[top:]
    return Screen((height + 3, 2 * width - 5), ((top, width - 1), (height - top, width)), positions)
