"""Energy fit after the cut: removed light is given to the remaining connections of its camera pixel (thesis 4.2.3)."""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray, FloatArray
from counterlight.tools.clusters.connections import Connections


def fit_composition(graph: Connections, keep: BoolArray) -> NDArray[np.float32]:
    """Rescale each camera pixel's kept connections to preserve its composition: Σ_j T'_kj = Σ_j T_kj.

    Each channel has its own factor (Σ_j T_kj) / (Σ_j kept T_kj). If no kept connection carries a channel, no factor can
    restore it; its light is then distributed over the kept connections by luminance.

    Returns (kept connections, 3).
    """
    camera, luminance = graph.camera[keep], graph.luminance[keep]
    share = luminance / _sums(camera, luminance, graph.shape[0])[camera]
    fitted = np.empty((camera.size, graph.weights.shape[1]), np.float32)
    for i in range(fitted.shape[1]):
        before = _sums(graph.camera, graph.weights[:, i], graph.shape[0])[camera]
        weights = graph.weights[keep, i].astype(np.float64)
        after = _sums(camera, weights, graph.shape[0])[camera]
        scaled = weights * np.divide(before, after, out=np.zeros_like(before), where=after > 0)
        fitted[:, i] = np.where(after > 0, scaled, before * share)
    return fitted


def _sums(camera: NDArray[np.int64], weights: NDArray[np.floating], camera_pixels: int) -> FloatArray:
    return np.bincount(camera, weights=weights, minlength=camera_pixels).astype(np.float64)  # empty sums are integers
