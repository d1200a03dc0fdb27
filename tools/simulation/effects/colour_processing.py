"""Colour processing: light of a primary depends on the codes of all primaries (vivid modes, white segments).

T has no processing; the projector's response has it. This module states how much it changes.
"""

import numpy as np

from counterlight.tools.simulation.scene import Scene

LEVELS = 9


def deviation(scene: Scene) -> float:
    """Returns the RMS difference from the light of the curves, as a share of that light's RMS, over all colours."""
    steps = np.linspace(0, 1, LEVELS)
    codes = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
    response = scene.projector.response
    alone = response.curves(codes)
    return float(np.linalg.norm(response.to_linear(codes) - alone) / np.linalg.norm(alone))
