"""How a medium's codes become light on the room's screen, all of it: what planes_to_linear is told.

A table (`lut`) comes between the viewer's controls and the transfer curve. Of the native type, it makes codes of the
medium's own curve and primaries; of the type conversion, codes of an ordinary screen: HDR is then not mapped again.
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
    """decoding : of the samples.  lift : added to every code.  transfer : (samples,) light over the code 0..1.

    lut : what codes within 0..1 become before that; None for what they are.
    rendition : what light then goes through; None for the screen's own.
    """

    decoding: Decoding
    lift: float
    lut: Cube | None
    transfer: NDArray[np.float32]
    rendition: Rendition | None


def signal_of(pixels: PixelFormat, adjustments: Adjustments = NEUTRAL) -> Signal | None:
    """The signal of a pixel format, as adjusted; None for radiance, which has no codes."""
    if pixels.layout == "radiance":
        return None
    decoding, lift = adjusted_decoding(decoding_of(pixels), pixels, adjustments)
    if adjustments.lut is not None and adjustments.lut_type == "conversion":
        pixels = replace(pixels, transfer="bt1886", primaries="bt709")
    transfer = adjusted_transfer(transfer_table(pixels.transfer), adjustments)
    return Signal(decoding, lift, adjustments.lut, transfer, rendition_of(pixels, adjustments))
