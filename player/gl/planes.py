"""Planes -> linear picture, upright (shaders/planes_to_linear.frag), with the viewer's controls of the coded signal."""

from collections.abc import Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from counterlight.gl.passes import Pass, Uniform, float_texture, plane_texture, table_texture
from counterlight.media.video import PixelFormat
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.device import Owner
from counterlight.pipeline.placement import shown_shape
from counterlight.pipeline.signal import Signal, signal_of

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
        signal = signal_of(pixels)
        defines: dict[str, int | None] = {LAYOUTS[pixels.layout]: None}
        if signal is not None:
            self._inputs["transfer"] = own(table_texture(context, signal.transfer))
            if signal.rendition is not None:
                self._inputs["gain"] = own(table_texture(context, signal.rendition.gain))
                defines["RENDITION"] = None
        target = float_texture(context, shown_shape(pixels))
        self._pass = own(Pass(context, "planes_to_linear.frag", target, defines, **_uniforms(pixels, signal)))
        self.adjust(NEUTRAL)

    def adjust(self, adjustments: Adjustments) -> None:
        """Take over what changes codes and what becomes of them; radiance has none."""
        signal = signal_of(self._pixels, adjustments)
        if signal is None:
            return
        self._pass.set(to_rgb=_by_columns(signal.decoding.to_rgb), lift=signal.lift)
        self._inputs["transfer"].write(signal.transfer)
        if signal.rendition is not None:
            self._pass.set(ootf=signal.rendition.ootf, top=signal.rendition.top)
            self._pass.set(to_screen=_by_columns(signal.rendition.matrix))
            self._inputs["gain"].write(signal.rendition.gain)

    def upload(self, planes: Sequence[NDArray[Any]]) -> None:
        for texture, plane in zip(self._planes, planes, strict=True):
            texture.write(plane)

    def run(self) -> moderngl.Texture:
        return self._pass.run(**self._inputs)

    def release(self) -> None:
        self._owner.release()


def _by_columns(matrix: NDArray[np.float64]) -> tuple[float, ...]:
    """As OpenGL wants it."""
    return tuple(matrix.T.ravel())


def _uniforms(pixels: PixelFormat, signal: Signal | None) -> dict[str, Uniform]:
    luma, chroma = pixels.planes[:2]
    uniforms: dict[str, Uniform] = {"stored_size": (luma.width, luma.height), "quarter_turns": pixels.rotation // 90}
    if signal is not None:
        decoding = signal.decoding
        uniforms |= {"black": tuple(decoding.black), "span": tuple(decoding.span)}
        if pixels.layout == "yuv":
            uniforms |= {
                "chroma_size": (chroma.width, chroma.height),
                "subsampling": decoding.subsampling,
                "chroma_offset": decoding.chroma_offset,
            }
    return uniforms
