"""The complete path from a medium's codes to light on the room's screen: the parameters of planes_to_linear.

A lookup table (`lut`) acts between the viewer's controls and the transfer curve. Type native: the output codes have the
medium's own curve and primaries. Type conversion: the output codes are those of an ordinary screen, and HDR is not
mapped again.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.files.cube import Cube
from counterlight.media.frames import PixelFormat
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments, adjusted_decoding, adjusted_transfer
from counterlight.pipeline.colour import Decoding, decoding_of
from counterlight.pipeline.rendition import Rendition, rendition_of
from counterlight.response import transfer_table


@dataclass(frozen=True, eq=False)
class Signal:
    """The parameters of planes_to_linear.

    decoding : decoding of the samples.
    lift : added to every code.
    lut : table applied to codes within 0..1 before the transfer; None for none.
    transfer : (samples,). Light over the code 0..1.
    rendition : conversion of the light; None if the light is the screen's own.
    """

    decoding: Decoding
    lift: float
    lut: Cube | None
    transfer: NDArray[np.float32]
    rendition: Rendition | None


def signal_of(pixels: PixelFormat, adjustments: Adjustments = NEUTRAL) -> Signal | None:
    """Return the adjusted signal of a pixel format; None for radiance, which has no codes."""
    if pixels.layout == "radiance":
        return None
    decoding, lift = adjusted_decoding(decoding_of(pixels), pixels, adjustments)
    if adjustments.lut is not None and adjustments.lut_type == "conversion":
        pixels = replace(pixels, transfer="bt1886", primaries="bt709")
    transfer = adjusted_transfer(transfer_table(pixels.transfer), adjustments)
    return Signal(decoding, lift, adjustments.lut, transfer, rendition_of(pixels, adjustments))
