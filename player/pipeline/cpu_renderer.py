"""The backend without OpenGL (`--backend cpu`): it draws with the CPU functions of counterlight.passes.

Pictures are arrays (height, width, channels), contiguous float32.
"""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.row_map import RowMap
from counterlight.media.frames import PixelFormat
from counterlight.passes.adaptation import PERCENT, Limits, tone_of
from counterlight.passes.drawing import CHANNELS, Array, Pass
from counterlight.passes.encode import Encode
from counterlight.passes.planes_to_linear import PlanesToLinear
from counterlight.passes.product import Combining, Rows
from counterlight.passes.refinement_step import Step, Ties
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.content import Succession, approach
from counterlight.pipeline.device import LONG_BYTES, NearLight, PathReport
from counterlight.pipeline.placement import shown_shape
from counterlight.pipeline.refinement import OVER_RELAXATION, momentum
from counterlight.pipeline.renderer import Renderer
from counterlight.pipeline.room import Room
from counterlight.pipeline.signal import signal_of
from counterlight.response import RasterResponse

NO_TONE = np.array([1.0, 0.0])


class Held:
    def release(self) -> None:
        """Does nothing: arrays need no release."""


class CpuDevice(Held):
    """Device of the pipeline that computes with Numba, and with numpy for rare passes."""

    def picture(self, picture: NDArray[Any]) -> Array:
        return np.array(picture, np.float32, order="C")

    def write(self, light: Array, picture: NDArray[np.floating]) -> None:
        light[...] = picture

    def mask(self, mask: NDArray[np.bool_]) -> Array:
        return mask.astype(np.float32)

    def canvas(self, shape: tuple[int, int], channels: int = CHANNELS) -> "CpuCanvas":
        return CpuCanvas(shape, channels)

    def store(self, room: Room) -> "_Maps":
        return _Maps(room)

    def planes(self, pixels: PixelFormat) -> "_Planes":
        return _Planes(pixels)

    def adapter(self, near_light: NearLight[Array], ambient: Array, most: Array, white: float) -> "_Adapter":
        return _Adapter(near_light, ambient, most, white)

    def encoder(self, shape: tuple[int, int], response: RasterResponse, scale: float, dither: str) -> "_Encoder":
        return _Encoder(shape, Encode(response, scale, dither))

    def stepper(self, shape: tuple[int, int], prior: Ties[Array]) -> "_Stepper":
        return _Stepper(shape, prior)

    def total(self, shape: tuple[int, int]) -> "_Total":
        return _Total()

    def read(self, light: NDArray[Any], dtype: type) -> NDArray[Any]:
        return light.astype(dtype)

    def finish(self) -> None:
        """Returns at once: nothing runs in the background."""


class CpuRenderer(Renderer[Array]):
    def __init__(self, room: Room) -> None:
        super().__init__(CpuDevice(), room)


class CpuCanvas(Held):
    def __init__(self, shape: tuple[int, int], channels: int = CHANNELS) -> None:
        self.picture: Array = np.zeros((*shape, channels), np.float32)

    def draw(self, made: Pass[Array]) -> Array:
        made.fill(self.picture)
        return self.picture

    def clear(self) -> None:
        self.picture.fill(0)


class _Maps(Held):
    weighs = False

    def __init__(self, room: Room) -> None:
        self.room, self.report = room, PathReport("cpu", LONG_BYTES)
        self._stored: dict[int, _Map] = {}

    def of(self, packed: RowMap) -> "_Map":
        if id(packed) not in self._stored:
            self._stored[id(packed)] = _Map(packed)
        return self._stored[id(packed)]


class _Map(Held):
    def __init__(self, packed: RowMap) -> None:
        self.output_shape, self.source_shape = packed.output_shape, packed.source_shape
        self._rows = Rows(packed)

    def product(self, combining: Combining = "") -> "_Product":
        if combining == "WEIGHED_RESIDUAL":
            raise ValueError("WEIGHED_RESIDUAL needs maps in words, which the processor does not store")
        return _Product(self._rows, combining)


class _Product(Held):
    def __init__(self, rows: Rows, combining: Combining) -> None:
        self._rows, self._combining = rows, combining
        self._target = np.zeros((*rows.output_shape, CHANNELS), np.float32)

    def run(self, source: Array, base: Array | None = None) -> Array:
        self._rows.fill(source, base, self._combining, self._target)
        return self._target


class _Planes(Held):
    def __init__(self, pixels: PixelFormat) -> None:
        self._pixels = pixels
        self._planes = [np.zeros((plane.height, plane.stride_samples), pixels.dtype) for plane in pixels.planes]
        self._upright = np.zeros((*shown_shape(pixels), CHANNELS), np.float32)
        self.adjust(NEUTRAL)

    def adjust(self, adjustments: Adjustments) -> None:
        self._drawn, self._pass = False, PlanesToLinear(self._pixels, signal_of(self._pixels, adjustments))

    def upload(self, planes: Sequence[NDArray[Any]]) -> None:
        self._drawn = False
        for kept, plane in zip(self._planes, planes, strict=True):
            np.copyto(kept, plane)

    def run(self) -> Array:
        if not self._drawn:
            self._pass.fill(self._planes, self._upright)
            self._drawn = True
        return self._upright


class _Adapter(Held):
    """Adapts frames. Near light is copied, because the next draw overwrites it."""

    def __init__(self, near_light: NearLight[Array], ambient: Array, most: Array, white: float) -> None:
        self._near_light, self._white, self._succession = near_light, white, Succession(lasting=True)
        near_white, near_ambient = (near_light(light).copy() for light in (np.ones_like(ambient), ambient))
        self._limits = Limits(near_white, near_ambient, ambient, most)
        self._before: NDArray[Any] = NO_TONE
        self._now: NDArray[Any] = NO_TONE

    def set(self, adapt: float, unit: float, black_level: float) -> None:
        self._budget, self._unit, self._black_level = adapt * PERCENT, unit, black_level
        self._succession.restart()

    def advance(self, *, cut: bool, duration_s: float) -> None:
        if self._succession.advance(cut=cut, duration_s=duration_s):
            self._before = self._now

    def run(self, placed: Array) -> Array:
        u = np.asarray(self._black_level + (1 - self._black_level) * (self._unit * placed), np.float32)
        found = tone_of(u, self._near_light(u), self._limits, self._white, self._budget)
        weight = 0.0 if self._succession.fresh else 1 - approach(self._succession.elapsed_s)
        self._now = (1 - weight) * found + weight * self._before
        self._succession.draw()
        return cast(Array, self._now)  # a float64 value, which only the pass Tone accepts


class _Encoder(Held):
    def __init__(self, shape: tuple[int, int], encode: Encode) -> None:
        self._encode, self._target = encode, np.zeros((*shape, CHANNELS), np.uint8)

    def run(self, light: Array, frame: int) -> NDArray[Any]:
        self._encode.fill(light, frame, self._target)
        return self._target


class _Stepper(Held):
    """Alternates between two pairs of targets."""

    def __init__(self, shape: tuple[int, int], prior: Ties[Array]) -> None:
        self._prior, self._draws = prior, any(picture.any() for picture in vars(prior).values())
        self._targets = [[np.zeros((*shape, CHANNELS), np.float32) for _ in range(2)] for _ in range(2)]

    def run(self, step: int, descent: Array, y: Array, p: Array, step_size: Array) -> tuple[Array, Array]:
        next_p, next_y = self._targets[step % 2]
        made = Step(descent, y, p, step_size, self._prior, momentum(step), OVER_RELAXATION)
        made.fill_both(next_p, next_y, draws=self._draws)
        return next_p, next_y


class _Total(Held):
    def run(self, picture: Array) -> NDArray[np.float64]:
        return np.asarray(picture.sum(axis=(0, 1), dtype=np.float64))
