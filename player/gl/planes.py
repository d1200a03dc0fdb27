"""Converts planes to an upright linear picture (shaders/planes_to_linear.frag), with the viewer's controls."""

from collections.abc import Callable, Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from counterlight.gl.passes import ShaderPass, Uniform, cube_texture, float_texture, plane_texture, table_texture
from counterlight.media.video import PixelFormat
from counterlight.passes.planes_to_linear import SHADER, Signal
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.device import Owner
from counterlight.pipeline.placement import shown_shape
from counterlight.pipeline.signal import signal_of

LAYOUTS = {"yuv": "LAYOUT_YUV", "rgb": "LAYOUT_RGB", "radiance": "LAYOUT_RADIANCE"}


class Planes:
    """The planes of one pixel format and the pass that reads them."""

    def __init__(self, context: moderngl.Context, pixels: PixelFormat) -> None:
        self._context, self._pixels = context, pixels
        self._owner, self._drawing = Owner(), Owner()
        dtype = np.dtype({8: np.uint8, 32: np.float32}.get(pixels.depth, np.uint16))
        self._planes = [
            self._owner.own(plane_texture(context, (plane.height, plane.stride_samples), dtype))
            for plane in pixels.planes
        ]
        self._build(signal_of(pixels))
        self.adjust(NEUTRAL)

    def adjust(self, adjustments: Adjustments) -> None:
        """Apply the settings that change codes and their conversion; they do not affect radiance."""
        signal = signal_of(self._pixels, adjustments)
        if signal is None:
            return
        if (signal.lut, signal.rendition is None) != self._built_for:
            self._build(signal)
        self._pass.set(to_rgb=_by_columns(signal.decoding.to_rgb), lift=signal.lift)
        self._tables["transfer"].write(signal.transfer)
        if signal.rendition is not None:
            self._pass.set(ootf=signal.rendition.ootf, top=signal.rendition.top)
            self._pass.set(to_screen=_by_columns(signal.rendition.matrix))
            self._tables["gain"].write(signal.rendition.gain)

    def upload(self, planes: Sequence[NDArray[Any]]) -> None:
        for texture, plane in zip(self._planes, planes, strict=True):
            texture.write(plane)

    def run(self) -> moderngl.Texture:
        return self._pass.run(**self._inputs)

    def release(self) -> None:
        self._drawing.release()
        self._owner.release()

    def _build(self, signal: Signal | None) -> None:
        """Build the pass for a signal. The previous pass stays if this fails."""
        drawing = Owner()
        with drawing:
            self._make(signal, drawing.own)
        self._drawing.release()
        self._drawing = drawing

    def _make(self, signal: Signal | None, own: Callable[[Any], Any]) -> None:
        context, pixels = self._context, self._pixels
        defines: dict[str, int | None] = {LAYOUTS[pixels.layout]: None}
        uniforms, tables, cubes = _uniforms(pixels, signal), {}, {}
        if signal is not None:
            tables["transfer"] = own(table_texture(context, signal.transfer))
            if signal.lut is not None:
                cubes["lut"], defines["LUT"] = own(cube_texture(context, signal.lut.table)), None
                low, high = signal.lut.low, signal.lut.high
                uniforms |= {"lut_low": tuple(low), "lut_span": tuple(high - low)}
            if signal.rendition is not None:
                tables["gain"] = own(table_texture(context, signal.rendition.gain))
                defines["RENDITION"] = None
        target = float_texture(context, shown_shape(pixels))
        made: ShaderPass = own(ShaderPass(context, SHADER, target, defines, **uniforms))
        planes = {f"plane_{i}": texture for i, texture in enumerate(self._planes)}
        self._pass, self._tables, self._inputs = made, tables, planes | tables | cubes
        self._built_for = None if signal is None else (signal.lut, signal.rendition is None)


def _by_columns(matrix: NDArray[np.float64]) -> tuple[float, ...]:
    """Flatten column by column, as OpenGL expects."""
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
