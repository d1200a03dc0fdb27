"""Wander: the gain of each channel changes from capture to capture, as with an automatic white balance.

Gains are 1 + w z, with z normal and cut at MOST. T has no wander; this module serves simulated captures.
"""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.scene import Scene

MOST = 2.0  # largest deviation of a gain, in standard deviations


def gains(spread: float, random: np.random.Generator) -> FloatArray:
    """Returns the gain of each channel in a capture, (3,)."""
    return np.asarray(1 + spread * np.clip(random.standard_normal(3), -MOST, MOST))


def deviation(scene: Scene) -> float:
    """Returns the standard deviation of the gains before they are cut."""
    return scene.camera.wander
