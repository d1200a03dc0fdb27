"""What a camera pixel counts for where several cameras see one place: each point of the screen counts once.

w = a f / Σ f: a is the screen's area that the pixel looks at, f how far inside its camera's picture those projector
pixels are that it sees, summed over all cameras that see them. So one camera's say fades into another's where its
picture ends.
"""

import numpy as np
from scipy import ndimage

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import Calibration
from counterlight.maps.row_map import SparseRows
from counterlight.screen import Screen
from counterlight.tools.transport.transport import luminance_matrix

LARGEST_PERCENTILE = 99.0  # of areas; folds of a screen that is continued far have any
LEAST = 1e-3  # lest a pixel that others see better is lost where they see worse


def shares(near: SparseRows, calibration: Calibration) -> FloatArray:
    """(camera pixels,), above 0 to 1; 1 throughout for one camera.

    near : T, (camera pixels, projector pixels).
    """
    screen = calibration.screen
    if screen is None:
        return np.ones(near.shape[0])
    T, inner = luminance_matrix(near).astype(np.float64), _depths(screen, calibration.mask).ravel()
    pixels = np.arange(near.shape[0]).reshape(calibration.camera.shape)
    light = np.asarray(T.sum(axis=1)).ravel()
    own, all_of_them = np.zeros(near.shape[0]), np.zeros(near.shape[0])
    for part in screen.parts:
        rows = pixels[part].ravel()
        seen, told = (T[rows].T @ values[rows] for values in ((inner > 0).astype(np.float64), inner))
        depth = T @ np.divide(told, seen, out=np.zeros_like(told), where=seen > 0)
        depth = np.divide(depth, light, out=np.zeros_like(depth), where=light > 0)
        all_of_them += depth
        own[rows] = depth[rows]
    say = np.divide(own, all_of_them, out=np.ones_like(own), where=all_of_them > 0)
    return np.asarray(np.maximum(say * _areas(screen, calibration.mask).ravel(), LEAST))


def _depths(screen: Screen, mask: BoolArray) -> FloatArray:
    """How far inside its camera's counted picture a pixel is, pixels of the screen; 0 where it does not count."""
    depths, scale = np.zeros(mask.shape), np.sqrt(_areas(screen, mask))
    for part in screen.parts:
        depths[part] = ndimage.distance_transform_edt(np.pad(mask[part], 1))[1:-1, 1:-1]
    return np.asarray(depths * scale)


def _areas(screen: Screen, mask: BoolArray) -> FloatArray:
    """Of the screen, that a pixel looks at, as a share of the largest that count."""
    across, down = (axis.astype(np.float64) for axis in screen.axes)
    areas = np.abs(across[..., 1] * down[..., 2] - across[..., 2] * down[..., 1])
    return np.asarray(np.clip(areas / np.percentile(areas[mask], LARGEST_PERCENTILE), 0, 1))
