"""The complete path from a medium's codes to light on the room's screen: the parameters of planes_to_linear.

A lookup table (`lut`) acts between the viewer's controls and the transfer curve. A table of type native gives codes
with the medium's own curve and primaries. A table of type conversion gives codes for an ordinary screen, and HDR is not
mapped again.

HDR is compressed below white, and wide gamuts are fitted to BT.709. A medium's light is 1 at its brightest code. For PQ
this is 10 000 cd/m². For HLG it is scene light. Scene light of luminance Y_S times Y_S^(γ − 1) is display light
(ITU-R BT.2100-2, table 5). For a colour with brightest channel x,

    colour ← gain(x) · colour,   gain(x) = EETF(x) / (target x)       (ITU-R BT.2390-10, 5.4.1, black at 0)

then keeps hue and saturation. One matrix converts to the screen's primaries (BT.709's). Colours outside the gamut are
mixed with grey of their luminance until they fit. Shaders and compiled passes read gain(x) from a table over ⁴√x.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from counterlight.media.frames import PixelFormat
from counterlight.passes.colour import decoding_of, to_screen
from counterlight.passes.planes_to_linear import Rendition, Signal
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments, adjusted_decoding, adjusted_transfer
from counterlight.response import PQ_PEAK, TABLE_SIZE, pq_codes, pq_light, transfer_table

FloatArray = NDArray[np.floating]
# cd/m², for media that state no peak: BT.2100's reference display, HLG's nominal display, the usual grading peak of PQ
UNSAID_PEAK = 1000.0
HLG_RANGE = 400.0, 2000.0  # cd/m²: range of BT.2100's formula for γ; beyond an end of the range, γ of this end


def signal_of(pixels: PixelFormat, adjustments: Adjustments = NEUTRAL) -> Signal | None:
    """Return the adjusted signal of a pixel format; None for radiance, which has no codes."""
    if pixels.layout == "radiance":
        return None
    decoding, lift = adjusted_decoding(decoding_of(pixels), pixels, adjustments)
    if adjustments.lut is not None and adjustments.lut_type == "conversion":
        pixels = replace(pixels, transfer="bt1886", primaries="bt709")
    transfer = adjusted_transfer(transfer_table(pixels.transfer), adjustments)
    return Signal(decoding, lift, adjustments.lut, transfer, rendition_of(pixels, adjustments))


def rendition_of(pixels: PixelFormat, adjustments: Adjustments) -> Rendition | None:
    """Return the conversion of a medium's light; None for radiance, and if the light needs no conversion."""
    matrix = to_screen(pixels.primaries)
    if pixels.transfer not in ("pq", "hlg"):
        plain = Rendition(0.0, 1.0, np.ones(TABLE_SIZE, np.float32), matrix)
        return None if pixels.primaries == "bt709" else plain
    peak = peak_of(pixels, adjustments)
    unit = PQ_PEAK if pixels.transfer == "pq" else peak
    ootf = _gamma(peak) - 1 if pixels.transfer == "hlg" else 0.0
    gain = tone_curve(unit, peak, adjustments.target_peak, adjustments.tone_mapping)
    return Rendition(ootf, min(peak / unit, 1.0), gain, matrix)


def peak_of(pixels: PixelFormat, adjustments: Adjustments) -> float:
    """Return the peak of an HDR medium in cd/m²: from the option, from the medium, or the usual value."""
    if adjustments.hdr_peak != "auto":
        return float(adjustments.hdr_peak)
    said = pixels.peak_nits if pixels.transfer == "pq" else 0.0  # HLG states no peak
    return said or UNSAID_PEAK


def tone_curve(unit: float, peak: float, target: float, tone_mapping: str) -> NDArray[np.float32]:
    """Return the gain of light, (samples,) over ⁴√(light / top). Light 1 is `unit` cd/m²; white is `target` cd/m²."""
    nits = min(peak, unit) * np.linspace(0, 1, TABLE_SIZE)[1:] ** 4
    shown = np.minimum(nits, target) if tone_mapping == "clip" else eetf(nits, min(peak, unit), target)
    gain = shown / nits * (unit / target)
    return np.concatenate([[unit / target], gain]).astype(np.float32)


def eetf(nits: FloatArray, peak: float, target: float) -> NDArray[np.float64]:
    """BT.2390's electrical-electrical transfer function, from a display of `peak` cd/m² to a display of `target` cd/m².

    Below a knee nothing changes; above it, a Hermite spline over PQ codes reaches the target with slope 0.
    """
    whole = pq_codes(np.array(peak / PQ_PEAK))
    most = float(pq_codes(np.array(target / PQ_PEAK)) / whole)
    if most >= 1:
        return np.asarray(nits, np.float64)
    code = np.clip(pq_codes(nits / PQ_PEAK) / whole, 0, 1)
    knee = 1.5 * most - 0.5
    t = np.maximum(code - knee, 0) / (1 - knee)
    spline = (2 * t**3 - 3 * t**2 + 1) * knee + (t**3 - 2 * t**2 + t) * (1 - knee) + (3 * t**2 - 2 * t**3) * most
    return np.where(code < knee, nits, PQ_PEAK * pq_light(spline * whole))


def _gamma(peak: float) -> float:
    """Return BT.2100's system gamma of HLG on a display of `peak` cd/m²."""
    return float(1.2 + 0.42 * np.log10(np.clip(peak, *HLG_RANGE) / 1000))
