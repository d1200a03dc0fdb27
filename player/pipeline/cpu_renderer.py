"""The backend without OpenGL (`--backend cpu`): compiled passes for every frame, numpy passes for rare operations.

Pictures are arrays (height, width, channels), contiguous float32.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.row_map import RowMap, unpack
from counterlight.media.frames import PixelFormat
from counterlight.pipeline import compiled, compiled_colour, compiled_encoding, encoding
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.compiled_passes import NOTHING, PASSES, Drawn, Picture, Whole, clip_sums, flat
from counterlight.pipeline.device import NearLight, Operation, Pass, Planes, StoredMaps
from counterlight.pipeline.placement import shown_shape
from counterlight.pipeline.reference_renderer import FLAGS, Adapter, Function, Held, Maps, ReferenceDevice
from counterlight.pipeline.refinement import OVER_RELAXATION, momentum
from counterlight.pipeline.renderer import Renderer
from counterlight.pipeline.room import Room
from counterlight.pipeline.signal import signal_of
from counterlight.response import RasterResponse

COMBINE = {
    "": compiled.REPLACE,
    "ADD_TO_BASE": compiled.ADD,
    "SUBTRACT_FROM_BASE": compiled.SUBTRACT,
    "CLAMP": compiled.CLAMP,
}
AS_IT_IS = np.array([0, 1], np.float32)  # identity transfer table
DITHERS = {"none": compiled_encoding.NO_DITHER, "ordered": compiled_encoding.ORDERED, "noise": compiled_encoding.NOISE}


class CpuRenderer(Renderer):
    def __init__(self, room: Room) -> None:
        super().__init__(CpuDevice(), room)


class CpuDevice(ReferenceDevice):
    """Device of the pipeline that computes with Numba."""

    def picture(self, picture: NDArray[Any]) -> Picture:
        return np.array(picture, np.float32, order="C")

    def make_pass(
        self, shader: str, shape: tuple[int, int], defines: Mapping[str, int | None] | None = None, **uniforms: Any
    ) -> Pass:
        if shader not in PASSES:
            return _Rare(super().make_pass(shader, shape, defines, **uniforms))
        flags = {FLAGS[name]: True for name in defines or {} if name in FLAGS}
        return Drawn(PASSES[shader], shape, uniforms | flags)

    def store(self, room: Room) -> StoredMaps:
        return Maps(room, "cpu", _Map)

    def planes(self, pixels: PixelFormat) -> Planes:
        return _Planes(pixels)

    def adapter(self, near_light: NearLight, ambient: Picture, most: Picture, white: float) -> Adapter:
        """Near light is computed from this device's pictures; a copy survives the next draw."""
        return Adapter(lambda light: near_light(self.picture(light)).copy(), ambient, most, white, clip_sums)

    def encoder(self, shape: tuple[int, int], response: RasterResponse, scale: float, dither: str) -> Operation:
        return _Encoder(shape, response, scale, dither)

    def stepper(self, shape: tuple[int, int], prior: Mapping[str, Picture]) -> Operation:
        return _Stepper(shape, prior)

    def total(self, shape: tuple[int, int]) -> Function:
        return Function(lambda picture: picture.sum(axis=(0, 1), dtype=np.float64))


class _Rare(Held):
    """A numpy pass whose result is converted to this device's format."""

    def __init__(self, twin: Pass) -> None:
        self._twin = twin
        self.set, self.clear = twin.set, twin.clear

    @property
    def target(self) -> Picture:
        return np.ascontiguousarray(self._twin.target, np.float32)

    def run(self, **pictures: Any) -> Picture:
        self._twin.run(**pictures)
        return self.target


class _Map(Held):
    """A row map with unsigned indices, which avoid Numba's wraparound check."""

    def __init__(self, packed: RowMap) -> None:
        rows = unpack(packed)
        self.output_shape, self.source_shape = packed.output_shape, packed.source_shape
        self.rows = rows.indptr.view(np.uint64), rows.indices.view(np.uint32), rows.weights

    def product(self, combine: str = "") -> "_Product":
        return _Product(self, COMBINE[combine])


class _Product(Held):
    def __init__(self, stored: _Map, combine: int) -> None:
        self._map, self._combine = stored, combine
        self._target = np.zeros((*stored.output_shape, 3), np.float32)

    def run(self, source: Picture, base: Picture | None = None) -> Picture:
        shape, expected = source.shape, (*self._map.source_shape, 3)
        if shape != expected or (base is not None and base.shape != self._target.shape):
            raise ValueError(f"source of shape {shape}, the row map reads {expected} and adds {self._target.shape}")
        pixels, beside, target = (_pixels(NOTHING if each is None else each) for each in (source, base, self._target))
        compiled.product(*self._map.rows, pixels, beside, self._combine, target)
        return self._target


def _pixels(picture: Picture) -> Picture:
    return picture.reshape(-1, 3)


class _Planes(Held):
    """Decodes codes with compiled.decode; radiance is copied as it is."""

    def __init__(self, pixels: PixelFormat) -> None:
        self._pixels, self._drawn = pixels, False
        self._planes = [np.zeros((plane.height, plane.stride_samples), pixels.dtype) for plane in pixels.planes]
        self._upright = np.zeros((*shown_shape(pixels), 3), np.float32)
        self._stored = np.rot90(self._upright, -(pixels.rotation // 90))
        self.adjust(NEUTRAL)

    def adjust(self, adjustments: Adjustments) -> None:
        self._drawn, self._cube, self._rendition = False, None, None
        signal = signal_of(self._pixels, adjustments)
        if signal is None:
            return
        decoding, rendition = signal.decoding, signal.rendition
        luma, chroma = self._pixels.planes[:2]
        (across, down), (left, above) = decoding.subsampling, decoding.chroma_offset
        matrix = decoding.to_rgb / decoding.span
        self._told = (
            *_samples(luma.height, chroma.height, down, above),
            *_samples(luma.width, chroma.width, across, left),
            matrix.astype(np.float32),
            (signal.lift - matrix @ decoding.black).astype(np.float32),
            signal.transfer if signal.lut is None else AS_IT_IS,
        )
        if signal.lut is not None:
            low, span, last = signal.lut.low, signal.lut.high - signal.lut.low, len(signal.lut.table) - 1
            self._cube = signal.lut.table, low.astype(np.float32), (last / span).astype(np.float32), signal.transfer
        if rendition is not None:
            numbers = np.float32(rendition.ootf), np.float32(rendition.top)
            self._rendition = *numbers, rendition.gain, rendition.matrix.astype(np.float32)

    def upload(self, planes: Sequence[NDArray[Any]]) -> None:
        self._drawn = False
        for kept, plane in zip(self._planes, planes, strict=True):
            np.copyto(kept, plane)

    def run(self) -> Picture:
        if not self._drawn:
            self._draw()
            self._drawn = True
        return self._upright

    def _draw(self) -> None:
        if self._pixels.layout != "radiance":
            compiled.decode(*self._planes, *self._told, *_walk(self._upright, self._stored), _pixels(self._upright))
            if self._cube is not None:
                compiled_colour.through_table(_pixels(self._upright), *self._cube)
            if self._rendition is not None:
                compiled_colour.on_screen(_pixels(self._upright), *self._rendition)
            return
        for i, plane in enumerate(self._planes):
            self._stored[..., i] = plane[: self._pixels.height, : self._pixels.width]


def _walk(upright: Picture, stored: Picture) -> tuple[int, int, int]:
    """Return the index of a view's first pixel within the upright picture, and the index steps right and down."""
    address = [each.__array_interface__["data"][0] for each in (upright, stored)]
    pixel = upright.strides[1]
    return (address[1] - address[0]) // pixel, stored.strides[1] // pixel, stored.strides[0] // pixel


def _samples(length: int, count: int, every: int, offset: float) -> tuple[Whole, Picture]:
    """Return the chroma samples on either side of each pixel, (2, length), and the second's weight, (length,)."""
    position = np.arange(length) / every + offset
    low = np.floor(position)
    return np.clip([low, low + 1], 0, count - 1).astype(np.uint32), (position - low).astype(np.float32)


class _Encoder(Held):
    def __init__(self, shape: tuple[int, int], response: RasterResponse, scale: float, dither: str) -> None:
        self._codes = np.ascontiguousarray(response.inverse_tables().swapaxes(1, 2))
        self._of_column, self._row_height = response.of_column, response.row_height
        self._mixes = response.matrices is not None
        self._colours = np.zeros((1, 3, 3), np.float32) if response.matrices is None else response.matrices
        none, segments = np.zeros((0, 2, 3, 1), np.float32), response.segment_tables()
        self._segments = none if segments is None else np.ascontiguousarray(segments.swapaxes(2, 3))
        self._scale, self._dither = np.float32(scale), DITHERS[dither]
        self._thresholds = encoding.bayer(8, 8)[..., 0].astype(np.float32)
        self._target = np.zeros((*shape, 3), np.uint8)

    def run(self, light: Picture, frame: int) -> NDArray[np.uint8]:
        whose = self._of_column, self._row_height
        projectors = self._codes, *whose, self._colours, self._mixes, self._segments
        dithered = self._dither, np.uint32(frame & 0xFFFFFFFF), self._thresholds
        compiled_encoding.encode(light, *projectors, self._scale, *dithered, self._target)
        return self._target


class _Stepper(Held):
    """Alternates between two pairs of targets."""

    def __init__(self, shape: tuple[int, int], prior: Mapping[str, Picture]) -> None:
        self._prior = [flat(prior[name]) for name in ("damping", "right", "down")]
        self._draws = any(picture.any() for picture in prior.values())
        self._targets = [[np.zeros((*shape, 3), np.float32) for _ in range(2)] for _ in range(2)]

    def run(self, step: int, descent: Picture, y: Picture, p: Picture, step_size: Picture) -> tuple[Picture, Picture]:
        next_p, next_y = self._targets[step % 2]
        pace = np.float32(momentum(step)), np.float32(OVER_RELAXATION)
        pictures = *(flat(picture) for picture in (descent, y, p, step_size)), *self._prior
        compiled.step(*pictures, self._draws, *pace, flat(next_p), flat(next_y))
        return next_p, next_y
