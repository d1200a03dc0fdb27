"""Camera curve: code values of captures are not proportional to light, as with a webcam's sRGB or a maker's S-curve.

T has no curve; this module serves simulated captures.
"""

from functools import lru_cache

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.response import Response
from counterlight.tools.simulation.scene import Scene

STEPS = 1 << 16


def encoded(light: FloatArray, response: Response) -> FloatArray:
    """Apply the inverse of the response: light 0..1 to codes 0..1, (rows, columns, 3)."""
    codes, curve = _curve(response)
    return np.stack([np.interp(light[..., i], curve[:, i], codes) for i in range(3)], axis=-1)


def deviation(scene: Scene) -> float:
    """Returns the RMS difference between codes and light, both 0..1, over all light."""
    light = np.repeat(np.linspace(0, 1, 256)[:, None], 3, axis=1)
    return float(np.sqrt(np.mean(np.square(encoded(light, scene.camera.response) - light))))


@lru_cache(maxsize=2)
def _curve(response: Response) -> tuple[FloatArray, FloatArray]:
    """Returns equally spaced code values, (steps,), and their light, (steps, 3)."""
    codes = np.linspace(0, 1, STEPS)
    return codes, response.to_linear(np.repeat(codes[:, None], 3, axis=1))
