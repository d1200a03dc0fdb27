"""The settings that a viewer changes during playback: mpv's picture controls, adaptation, test cards and placement.

mpv's four controls act on the gamma-coded signal, before it becomes light, with mpv's ranges and meaning (csputils.c).
For a code R' = (r, g, b), 0..1, with luma y by the medium's own weights,

    R' ← clamp(k (y + s (R' − y)) + l)^(1/γ),   k = 1 + contrast/100,   s = 1 + saturation/100,
                                                l = brightness/100,     γ = 8^(gamma/100).

mpv does not change the saturation of RGB pictures; here RGB pictures use BT.709's luma. OpenEXR pictures are radiance
and have no codes, so the four controls do not change them. Black level and adaptation act on linear light, for every
picture.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.files.cube import Cube
from counterlight.media.frames import PixelFormat
from counterlight.passes.colour import LUMA_WEIGHTS, Decoding
from counterlight.pipeline.placement import Corners, check_corners
from counterlight.pipeline.test_cards import CARDS
from counterlight.pipeline.value_types import FLAG, Choice, Kind, Number, Places, UnreadError
from counterlight.viewpoints import FARTHEST, MOST_VIEWS, Viewpoint

LARGEST_GAMMA = 8.0
CONTROL = Number(-100, 100, whole=True)
NITS = Number(50, 10_000, noun="cd/m²")


KINDS: dict[str, Kind] = {
    "brightness": CONTROL,
    "contrast": CONTROL,
    "gamma": CONTROL,
    "saturation": CONTROL,
    "black_level": Number(0, 0.5),
    "adapt": Number(0, 100),
    "flicker": Number(0, 0.95),
    "clipping": FLAG,
    "target_peak": NITS,
    "hdr_peak": replace(NITS, words=("auto",)),
    "tone_mapping": Choice(("bt.2390", "clip")),
    "lut_type": Choice(("native", "conversion")),
    "viewpoint": Places("all", FARTHEST, MOST_VIEWS),
    "card": Choice(CARDS),
}


@dataclass(frozen=True)
class Adjustments:
    """Settings that can change during playback; the defaults do not change the picture. show/options.py explains them.

    adapt : see player/pipeline/content.py.
    flicker : weight of the previous frame's drive.
    target_peak, hdr_peak, tone_mapping : see player/pipeline/signal.py.
    viewpoint : see counterlight.viewpoints.
    card : one of counterlight.pipeline.test_cards.CARDS, shown without compensation; None shows the picture.
    corners : corners of the picture in the camera's view; None fits the picture in.
    lut : lookup table for codes; see player/pipeline/signal.py.

    Raises InputError for a value out of its range.
    """

    brightness: int = 0
    contrast: int = 0
    gamma: int = 0
    saturation: int = 0
    black_level: float = 0.0
    adapt: float = 0.0
    flicker: float = 0.0
    clipping: bool = False
    target_peak: float = 203.0
    hdr_peak: float | str = "auto"
    tone_mapping: str = "bt.2390"
    lut_type: str = "native"
    viewpoint: Viewpoint = "all"
    lut: Cube | None = None
    card: str | None = None
    corners: Corners | None = None

    def __post_init__(self) -> None:
        for name, kind in KINDS.items():
            value = getattr(self, name)
            if name == "card" and value is None:
                continue
            try:
                kind.read(value)
            except UnreadError as error:
                raise InputError(f"{'test-card' if name == 'card' else name.replace('_', '-')}: {error}") from None
        if self.corners is not None:
            check_corners(self.corners)


def adjusted_decoding(decoding: Decoding, pixels: PixelFormat, adjustments: Adjustments) -> tuple[Decoding, float]:
    """Return the decoding with contrast and saturation in its matrix, and the offset of every code (brightness)."""
    kr, kb = LUMA_WEIGHTS.get(pixels.matrix, LUMA_WEIGHTS["bt709"])
    gain, saturation = 1 + adjustments.contrast / CONTROL.high, 1 + adjustments.saturation / CONTROL.high
    luma = np.outer(np.ones(3), (kr, 1 - kr - kb, kb))
    matrix = gain * (saturation * np.eye(3) + (1 - saturation) * luma)
    return replace(decoding, to_rgb=matrix @ decoding.to_rgb), adjustments.brightness / CONTROL.high


def adjusted_transfer(table: NDArray[np.float32], adjustments: Adjustments) -> NDArray[np.float32]:
    """Return the transfer table with the viewer's gamma applied: light of code^(1/γ)."""
    if not adjustments.gamma:
        return table
    codes = np.linspace(0, 1, table.size)
    exponent = float(LARGEST_GAMMA ** (-adjustments.gamma / CONTROL.high))
    return np.asarray(np.interp(codes**exponent, codes, table), np.float32)


NEUTRAL = Adjustments()
