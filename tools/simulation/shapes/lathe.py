"""Solids of revolution: a profile turned about an axis."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.shapes.triangles import Triangles, over_grid


def turned(
    base: FloatArray, up: FloatArray, frame: tuple[FloatArray, FloatArray], profile: FloatArray, detail: int
) -> Triangles:
    """Turn a profile about an axis.

    The outside lies to the right of the outline, drawn with the radius to the right and the height up. A solid is
    therefore drawn from its bottom, up the outside, to its top. u runs around, v along the outline by its points.

    profile : (n, 2). Radius and height, in order along the outline; closed if it starts and ends on the axis.
    """
    angle = 2 * np.pi * np.linspace(0, 1, detail + 1)
    outwards = np.cos(angle)[:, None] * frame[0] + np.sin(angle)[:, None] * frame[1]
    outwards[-1] = outwards[0]
    points = base + profile[:, None, :1] * outwards[None] + profile[:, None, 1:] * up
    closed = bool(profile[0, 0] == 0 and profile[-1, 0] == 0)
    # ∂u × ∂v points outwards: u runs counterclockwise about the axis.
    return over_grid(points, None, closed=closed, wraps=True)
