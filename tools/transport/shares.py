"""Weights of camera pixels where several cameras see one place: each point of the screen counts once.

w = a f / Σ f. a is the screen area that the pixel sees. f is how far the seen projector pixels are from the border of
the camera's picture. The sum is over all cameras that see them. Towards the border of one camera's picture, its weight
therefore fades into the other cameras' weights.
"""

import numpy as np
from scipy import ndimage

from counterlight.arrays import BoolArray, FloatArray
from counterlight.calibration import Calibration
from counterlight.maps.row_map import SparseRows
from counterlight.screen import Screen
from counterlight.tools.transport.transport import luminance_matrix

LARGEST_PERCENTILE = 99.0  # of areas; folds of a screen that is continued far have any area
LEAST = 1e-3  # smallest weight; pixels that other cameras see better are kept


def shares(near: SparseRows, calibration: Calibration) -> FloatArray:
    """Return weights (camera pixels,), above 0 to 1; all 1 for one camera.

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
    """Return each pixel's distance from the border of its camera's mask, in screen pixels; 0 outside the mask."""
    depths, scale = np.zeros(mask.shape), np.sqrt(_areas(screen, mask))
    for part in screen.parts:
        depths[part] = ndimage.distance_transform_edt(np.pad(mask[part], 1))[1:-1, 1:-1]
    return np.asarray(depths * scale)


def _areas(screen: Screen, mask: BoolArray) -> FloatArray:
    """Return the screen area that each pixel sees, relative to the largest area of pixels that count."""
    across, down = (axis.astype(np.float64) for axis in screen.axes)
    areas = np.abs(across[..., 1] * down[..., 2] - across[..., 2] * down[..., 1])
    return np.asarray(np.clip(areas / np.percentile(areas[mask], LARGEST_PERCENTILE), 0, 1))
