"""Planes -> linear picture, upright (shaders/planes_to_linear.frag), with the viewer's controls of the coded signal."""

from collections.abc import Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from counterlight.gl.passes import Pass, Uniform, float_texture, plane_texture, table_texture
from counterlight.media.video import PixelFormat
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments, adjusted_decoding, adjusted_transfer
from counterlight.pipeline.colour import decoding_of
from counterlight.pipeline.device import Owner
from counterlight.pipeline.placement import shown_shape
from counterlight.response import transfer_table

LAYOUTS = {"yuv": "LAYOUT_YUV", "rgb": "LAYOUT_RGB", "radiance": "LAYOUT_RADIANCE"}


class Planes:
    """The planes of one pixel format and the pass that reads them."""

    def __init__(self, context: moderngl.Context, pixels: PixelFormat) -> None:
        self._owner, self._pixels = Owner(), pixels
        own = self._owner.own
        dtype = np.dtype({8: np.uint8, 32: np.float32}.get(pixels.depth, np.uint16))
        self._planes = [
            own(plane_texture(context, (plane.height, plane.stride_samples), dtype)) for plane in pixels.planes
        ]
        self._inputs = {f"plane_{i}": texture for i, texture in enumerate(self._planes)}
        self._codes = pixels.layout != "radiance"
        if self._codes:
            self._transfer = transfer_table(pixels.transfer)
            self._inputs["transfer"] = own(table_texture(context, self._transfer))
        target, defines = float_texture(context, shown_shape(pixels)), {LAYOUTS[pixels.layout]: None}
        self._pass = own(Pass(context, "planes_to_linear.frag", target, defines, **_uniforms(pixels)))
        self.adjust(NEUTRAL)

    def adjust(self, adjustments: Adjustments) -> None:
        """Take over brightness, contrast, gamma and saturation; radiance has no codes that they could change."""
        if not self._codes:
            return
        decoding, lift = adjusted_decoding(decoding_of(self._pixels), self._pixels, adjustments)
        self._pass.set(to_rgb=tuple(decoding.to_rgb.T.ravel()), lift=lift)  # column by column, as OpenGL wants it
        self._inputs["transfer"].write(adjusted_transfer(self._transfer, adjustments))

    def upload(self, planes: Sequence[NDArray[Any]]) -> None:
        for texture, plane in zip(self._planes, planes, strict=True):
            texture.write(plane)

    def run(self) -> moderngl.Texture:
        return self._pass.run(**self._inputs)

    def release(self) -> None:
        self._owner.release()


def _uniforms(pixels: PixelFormat) -> dict[str, Uniform]:
    luma, chroma = pixels.planes[:2]
    uniforms: dict[str, Uniform] = {"stored_size": (luma.width, luma.height), "quarter_turns": pixels.rotation // 90}
    if pixels.layout != "radiance":
        decoding = decoding_of(pixels)
        uniforms |= {"black": tuple(decoding.black), "span": tuple(decoding.span)}
        if pixels.layout == "yuv":
            uniforms |= {
                "chroma_size": (chroma.width, chroma.height),
                "subsampling": decoding.subsampling,
                "chroma_offset": decoding.chroma_offset,
            }
    return uniforms
