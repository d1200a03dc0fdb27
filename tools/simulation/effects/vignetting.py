"""Vignetting: a lens passes less light towards the corners of its picture.

"cos4" is the natural falloff of a simple lens, cos⁴ α at an angle α from the axis (Reiss 1945). A number is the share
lost in the corner, growing with the square of the distance from the centre.
"""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.devices import Device


def transmission(device: Device) -> FloatArray:
    """Share of the light that each pixel passes, (pixels,), 1 in the centre."""
    x = (2 * (np.arange(device.width) + 0.5) / device.width - 1) * device.tan_half[0]
    y = (2 * (np.arange(device.height) + 0.5) / device.height - 1) * device.tan_half[1]
    square = (x[None, :] ** 2 + y[:, None] ** 2).ravel()  # tan² α
    if device.vignetting == "cos4":
        return np.asarray((1 + square) ** -2)
    corner = device.tan_half[0] ** 2 + device.tan_half[1] ** 2
    return np.asarray(1 - float(device.vignetting) * square / corner)
