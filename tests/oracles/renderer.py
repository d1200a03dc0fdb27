"""The pipeline of renderer.py over formulas in numpy: tests compare both backends with it.

Rare passes have no formula here, because their CPU functions are numpy already.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.prior import Prior
from counterlight.maps.row_map import PreparedRows, RowMap
from counterlight.media.frames import PixelFormat
from counterlight.passes.adaptation import PERCENT, Limits
from counterlight.passes.certificate import block_sum
from counterlight.passes.combine import Blend, Combine
from counterlight.passes.desired import Desired
from counterlight.passes.drawing import CHANNELS, Pass
from counterlight.passes.moved import MovedDrive
from counterlight.passes.pinned import Pinned
from counterlight.passes.refinement_step import Ties
from counterlight.passes.resample import Resample
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.content import Succession, approach
from counterlight.pipeline.cpu_renderer import NO_TONE, Held
from counterlight.pipeline.device import LONG_BYTES, PathReport
from counterlight.pipeline.refinement import OVER_RELAXATION, momentum
from counterlight.pipeline.renderer import Renderer
from counterlight.pipeline.room import Room
from counterlight.pipeline.signal import signal_of
from counterlight.response import RasterResponse
from tests.oracles import adaptation, encoding, formulas

FloatArray = NDArray[np.floating]
COMBINED: dict[str, Callable[[Any, Any], FloatArray]] = {
    "": lambda base, product: product,
    "ADD_TO_BASE": lambda base, product: base + product,
    "SUBTRACT_FROM_BASE": lambda base, product: base - product,
    "CLAMP": lambda base, product: np.clip(product, 0, 1),
}


class ReferenceRenderer(Renderer[Any]):
    def __init__(self, room: Room) -> None:
        super().__init__(ReferenceDevice(), room)


class ReferenceDevice(Held):
    """Device of the pipeline that computes with numpy; pictures are arrays (height, width, channels)."""

    def picture(self, picture: FloatArray) -> FloatArray:
        return picture

    def write(self, light: FloatArray, picture: FloatArray) -> None:
        light[...] = picture

    def mask(self, mask: NDArray[np.bool_]) -> Any:
        return mask

    def canvas(self, shape: tuple[int, int], channels: int = CHANNELS) -> "Canvas":
        return Canvas(shape, channels)

    def store(self, room: Room) -> "Maps":
        return Maps(room)

    def planes(self, pixels: PixelFormat) -> "Planes":
        return Planes(pixels)

    def adapter(self, near_light: Any, ambient: FloatArray, most: FloatArray, white: float) -> "Adapter":
        return Adapter(near_light, ambient.astype(np.float64), most, white)

    def encoder(self, shape: tuple[int, int], response: RasterResponse, scale: float, dither: str) -> Any:
        white = {"segments": response.segment_tables(), "processing": response.processing_tables}
        encode = partial(encoding.encode, colours=response.matrices, **white)
        tables, whose = response.inverse_tables(), (response.of_column, response.row_height)
        return Function(lambda light, frame: encode(light, tables, scale, dither, frame, *whose))

    def stepper(self, shape: tuple[int, int], prior: Ties[Any]) -> Any:
        step, drawn = formulas.refinement_step, Prior(**vars(prior))
        return Function(lambda k, descent, y, p, size: step(descent, y, p, size, drawn, momentum(k), OVER_RELAXATION))

    def total(self, shape: tuple[int, int]) -> Any:
        return Function(lambda picture: block_sum(picture, max(shape))[0, 0])

    def read(self, light: NDArray[Any], dtype: type) -> NDArray[Any]:
        return light.astype(dtype)

    def finish(self) -> None:
        """Returns at once: nothing runs in the background."""


class Function(Held):
    def __init__(self, run: Callable[..., Any]) -> None:
        self.run = run


class Canvas(Held):
    def __init__(self, shape: tuple[int, int], channels: int) -> None:
        self._shape = *shape, channels
        self.picture: FloatArray = np.zeros(self._shape)

    def draw(self, made: Pass[Any]) -> FloatArray:
        found = formula(made, self._shape[:2])
        if found is None:
            found = np.zeros(self._shape)
            made.fill(found)  # type: ignore[arg-type]  # float64
        self.picture[...] = found
        return self.picture

    def clear(self) -> None:
        self.picture[...] = 0


def formula(made: Pass[Any], shape: tuple[int, int]) -> FloatArray | None:
    """Return a pass by its formula, (*shape, 3); None for a rare pass."""
    match made:
        case Combine():
            return formulas.combine(made.first, made.second, made.factor, clamp=made.clamp)
        case Blend():
            return formulas.blend(made.now, made.before, made.weight, made.gain)
        case Desired():
            tone = () if made.tone is None else (made.tone.tone, made.tone.unit, made.tone.black_level)
            rows = {} if made.mixed is None else vars(made.mixed)
            limits = {"full": made.full, "squares": made.squares, "clamp": made.clamp}
            limits |= {} if made.weights is None else {"weights": made.weights}
            return formulas.desired_light(made.picture, made.ambient, made.white, *tone, **limits, **rows)
        case Resample():
            along = 1 - made.axis
            return formulas.resample_axis(made.source, along, shape[along], made.origin, made.extent)
        case Pinned():
            screen = {} if made.screen is None else vars(made.screen)
            return formulas.pinned(made.source, shape, np.reshape(made.to_source, (3, 3)).T, **screen)
        case MovedDrive():
            return formulas.moved(made.drive, made.projectors)
    return None


class Maps(Held):
    """A room's maps, each stored on first use."""

    weighs = False

    def __init__(self, room: Room) -> None:
        self.room, self.report = room, PathReport("reference", LONG_BYTES)
        self._stored: dict[int, _Map] = {}

    def of(self, packed: RowMap) -> "_Map":
        if id(packed) not in self._stored:
            self._stored[id(packed)] = _Map(packed)
        return self._stored[id(packed)]


class _Map(Held):
    def __init__(self, packed: RowMap) -> None:
        self.output_shape, self.source_shape = packed.output_shape, packed.source_shape
        self._rows = PreparedRows(packed)

    def product(self, combining: str = "") -> Function:
        combined = COMBINED[combining]
        return Function(lambda source, base=None: combined(base, self._rows.apply(source)))


class Planes(Held):
    def __init__(self, pixels: PixelFormat) -> None:
        self._pixels, self._adjustments = pixels, NEUTRAL
        self._upright: FloatArray | None = None

    def adjust(self, adjustments: Adjustments) -> None:
        self._adjustments, self._upright = adjustments, None

    def upload(self, planes: Sequence[NDArray[Any]]) -> None:
        self._planes, self._upright = [plane.copy() for plane in planes], None

    def run(self) -> FloatArray:
        if self._upright is None:
            signal = signal_of(self._pixels, self._adjustments)
            self._upright = formulas.planes_to_linear(self._planes, self._pixels, signal)
        return self._upright


class Adapter(Held):
    def __init__(self, near_light: Any, ambient: FloatArray, most: FloatArray, white: float) -> None:
        self._near_light, self._white, self._succession = near_light, white, Succession(lasting=True)
        white_near, ambient_near = (near_light(light).copy() for light in (np.ones_like(ambient), ambient))
        self._limits = Limits(white_near, ambient_near, ambient, most)  # one canvas holds each in turn
        self._before: FloatArray = NO_TONE
        self._now: FloatArray = NO_TONE

    def set(self, adapt: float, unit: float, black_level: float) -> None:
        self._budget, self._unit, self._black_level = adapt * PERCENT, unit, black_level
        self._succession.restart()

    def advance(self, *, cut: bool, duration_s: float) -> None:
        if self._succession.advance(cut=cut, duration_s=duration_s):
            self._before = self._now

    def run(self, placed: FloatArray) -> FloatArray:
        u = formulas.desired_light(placed, 0.0, 1.0, NO_TONE, self._unit, self._black_level)
        found = adaptation.tone_of(u, self._near_light(u), self._limits, self._white, self._budget)
        weight = 0.0 if self._succession.fresh else 1 - approach(self._succession.elapsed_s)
        self._now = formulas.blend(found, self._before, weight)
        self._succession.draw()
        return self._now
