"""Vignetting: a lens transmits less light towards the corners of its picture.

"cos4" is the natural falloff of a simple lens, cos⁴ α at an angle α from the axis (Reiss 1945). A number is the share
lost in the corner; the loss grows with the squared distance from the centre.
"""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.devices import Device


def transmission(device: Device) -> FloatArray:
    """Returns the share of the light that each pixel transmits, (pixels,); 1 in the centre."""
    y, x = np.indices((device.height, device.width)) + 0.5
    if device.vignetting == "cos4":
        across, up = device.direction_of(x.ravel(), y.ravel())
        return np.asarray((1 + (across**2 + up**2)) ** -2)
    width, height = device.tan_half
    square = ((2 * x / device.width - 1) * width) ** 2 + ((2 * y / device.height - 1) * height) ** 2
    return np.asarray(1 - float(device.vignetting) * square.ravel() / (width**2 + height**2))
