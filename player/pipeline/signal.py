"""The complete path from a medium's codes to light on the room's screen: the parameters of planes_to_linear.

A lookup table (`lut`) acts between the viewer's controls and the transfer curve. A table of type native gives codes
with the medium's own curve and primaries. A table of type conversion gives codes for an ordinary screen, and HDR is not
mapped again.
"""

from dataclasses import replace

from counterlight.media.frames import PixelFormat
from counterlight.passes.colour import decoding_of
from counterlight.passes.planes_to_linear import Signal
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments, adjusted_decoding, adjusted_transfer
from counterlight.pipeline.rendition import rendition_of
from counterlight.response import transfer_table


def signal_of(pixels: PixelFormat, adjustments: Adjustments = NEUTRAL) -> Signal | None:
    """Return the adjusted signal of a pixel format; None for radiance, which has no codes."""
    if pixels.layout == "radiance":
        return None
    decoding, lift = adjusted_decoding(decoding_of(pixels), pixels, adjustments)
    if adjustments.lut is not None and adjustments.lut_type == "conversion":
        pixels = replace(pixels, transfer="bt1886", primaries="bt709")
    transfer = adjusted_transfer(transfer_table(pixels.transfer), adjustments)
    return Signal(decoding, lift, adjustments.lut, transfer, rendition_of(pixels, adjustments))
