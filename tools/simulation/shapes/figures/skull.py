"""A skull seen from the front, as heights over a rectangle 3 wide and 4 high: ellipsoids with hollows."""

import numpy as np

from counterlight.arrays import FloatArray


def heights(u: FloatArray, v: FloatArray) -> FloatArray:
    """Returns height (…) at u, v (…) in 0..1: 0 outside the skull, 1 at its brow."""
    x, y = 3 * (np.abs(u - 0.5)), 4 * (v - 0.5)  # thirds of the width; the skull is symmetric
    bone = _joined(
        0.98 * _dome(x, y - 0.55, 1.20, 1.28),  # cranium
        0.86 * _dome(x - 0.62, y + 0.42, 0.48, 0.42),  # cheek bone
        0.92 * _dome(x, y + 0.78, 0.62, 0.86),  # upper jaw
        0.80 * _dome(x, y + 1.28, 0.66, 0.58),  # chin
        0.70 * _dome(x - 0.60, y + 1.00, 0.20, 0.62),  # branch of the lower jaw
    )
    brow = 0.10 * _bump(x - 0.50, y - 0.34 + 0.25 * (x - 0.5) ** 2, 0.34, 0.10)
    bridge = 0.10 * _bump(x, y + 0.05, 0.13, 0.26)
    holes = (
        0.72 * _bowl(x - 0.47, y + 0.02 + 0.15 * (x - 0.47), 0.31, 0.28),  # eye
        0.65 * _pit(x, y + 0.50, np.maximum(0.17 - 0.35 * (y + 0.50), 0.04), 0.27, 0.12),  # nose
        0.28 * _pit(x - 0.60, y + 0.86, 0.14, 0.22, 0.1),  # hollow of the cheek
        0.16 * _pit(x - 1.12, y - 0.20, 0.16, 0.34, 0.15),  # temple
    )
    deep = np.asarray(sum(holes))
    raised = bone + np.where(bone > 0, brow + bridge, 0)
    return np.asarray(np.clip(raised - np.minimum(deep, 0.95 * bone) - _teeth(x, y), 0, 1))


def _teeth(x: FloatArray, y: FloatArray) -> FloatArray:
    """Returns grooves between the teeth, and between the two rows of teeth."""
    level = y + 1.06 - 0.10 * x**2
    near = 1 / (1 + np.exp((np.abs(level) - 0.20) / 0.02)) / (1 + np.exp((x - 0.46) / 0.02))
    gaps = np.exp(-(((x / 0.125) % 1 - 0.5) ** 2) / 0.012)
    return np.asarray(near * (0.10 * gaps + 0.16 * np.exp(-((level / 0.035) ** 2))))


def _dome(x: FloatArray, y: FloatArray, wide: float, high: float) -> FloatArray:
    """Returns the upper half of an ellipsoid of height 1; 0 outside."""
    return np.sqrt(np.maximum(1 - (x / wide) ** 2 - (y / high) ** 2, 0))


def _bump(x: FloatArray, y: FloatArray, wide: float, high: float) -> FloatArray:
    return np.asarray(np.exp(-((x / wide) ** 2) - (y / high) ** 2))


def _bowl(x: FloatArray, y: FloatArray, wide: float, high: float) -> FloatArray:
    """Returns a round hollow of depth 1."""
    return np.asarray(np.exp(-(np.hypot(x / wide, y / high) ** 3)))


def _pit(x: FloatArray, y: FloatArray, wide: float | FloatArray, high: float, slope: float) -> FloatArray:
    """Returns a hollow of depth 1; `slope` is the width of its wall as a share of its size."""
    return np.asarray(1 / (1 + np.exp(np.minimum((np.hypot(x / wide, y / high) - 1) / slope, 60))))


def _joined(*parts: FloatArray) -> FloatArray:
    """Returns the maximum of some heights, rounded where they meet; exactly 0 where all are 0."""
    total = np.asarray(sum(part**8 for part in parts))
    return np.asarray(total ** (1 / 8))
