"""How a medium's codes become light on the room's screen, all of it: what planes_to_linear is told."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from counterlight.media.frames import PixelFormat
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments, adjusted_decoding, adjusted_transfer
from counterlight.pipeline.colour import Decoding, decoding_of
from counterlight.pipeline.rendition import Rendition, rendition_of
from counterlight.response import transfer_table


@dataclass(frozen=True, eq=False)
class Signal:
    """decoding : of the samples.  lift : added to every code.  transfer : (samples,) light over the code 0..1.

    rendition : what light then goes through; None for the screen's own.
    """

    decoding: Decoding
    lift: float
    transfer: NDArray[np.float32]
    rendition: Rendition | None


def signal_of(pixels: PixelFormat, adjustments: Adjustments = NEUTRAL) -> Signal | None:
    """The signal of a pixel format, as adjusted; None for radiance, which has no codes."""
    if pixels.layout == "radiance":
        return None
    decoding, lift = adjusted_decoding(decoding_of(pixels), pixels, adjustments)
    transfer = adjusted_transfer(transfer_table(pixels.transfer), adjustments)
    return Signal(decoding, lift, transfer, rendition_of(pixels, adjustments))
