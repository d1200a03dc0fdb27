"""The pipeline of renderer.py over numpy functions: tests compare both backends with it."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.prior import Prior
from counterlight.maps.row_map import RowMap
from counterlight.media.frames import PixelFormat
from counterlight.pipeline import adaptation, device, encoding, reference
from counterlight.pipeline.adaptation import Limits, SumsOf
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.content import Succession, approach
from counterlight.pipeline.device import LONG_BYTES, NearLight, Operation, Pass, PathReport, StoredMap, StoredMaps
from counterlight.pipeline.drift import moved
from counterlight.pipeline.reference import PreparedRows
from counterlight.pipeline.refinement import OVER_RELAXATION, momentum
from counterlight.pipeline.renderer import Renderer
from counterlight.pipeline.room import Room
from counterlight.pipeline.signal import signal_of
from counterlight.response import RasterResponse

FloatArray = NDArray[np.floating]
NO_TONE = np.array([1.0, 0.0])
PERCENT = 0.01
# Arguments are named as the shaders' uniforms and textures. Colours and thresholds come from views.py.
TWINS: dict[str, Callable[..., FloatArray]] = {
    "blend.frag": reference.blend,
    "block_sum.frag": lambda source, side, target: reference.block_sum(source, side)[: target[0], : target[1]],
    "clipping.frag": lambda view, asked, white, most=None, **_: reference.clipping(view, asked, most, white),
    "combine.frag": reference.combine,
    "desired.frag": reference.desired_light,
    "error_map.frag": lambda seen, b, ambient, reach, white, **_: reference.error_map(seen, ambient, b, reach, white),
    "gap.frag": reference.gap_terms,
    "impossible.frag": lambda reach, white, **_: reference.impossible(reach, white),
    "inverse.frag": reference.inverse,
    "mix.frag": reference.mix,
    "moved.frag": moved,
    "pinned.frag": lambda source, to_source, target, **screen: reference.pinned(
        source, target, np.reshape(to_source, (3, 3)).T, **screen
    ),
    "reach.frag": lambda unlimited=None, **inputs: reference.reach_of(**inputs),
    "recolour.frag": reference.recolour,
    "refinement_step.frag": reference.against_gradient,  # with SLOPE; the stepper makes the steps
    "resample.frag": lambda source, axis, origin, extent, target: reference.resample_axis(
        source, 1 - axis, target[1 - axis], origin, extent
    ),
    "split.frag": reference.split,
    "weighted.frag": reference.weighted,
}
# Shader defines and the keyword arguments that replace them.
FLAGS = {"ABOVE": "above", "CLAMP": "clamp", "SIDE": "side", "SQUARED": "squared"}
PLACING = "block_sum.frag", "pinned.frag", "resample.frag"  # passes that need the shape of their target
COMBINE: dict[str, Callable[[Any, Any], FloatArray]] = {
    "": lambda base, product: product,
    "ADD_TO_BASE": lambda base, product: base + product,
    "SUBTRACT_FROM_BASE": lambda base, product: base - product,
    "CLAMP": lambda base, product: np.clip(product, 0, 1),
}


class ReferenceRenderer(Renderer):
    def __init__(self, room: Room) -> None:
        super().__init__(ReferenceDevice(), room)


class ReferenceDevice:
    """Device of the pipeline that computes with numpy; pictures are arrays (height, width, channels)."""

    def picture(self, picture: FloatArray) -> FloatArray:
        return picture

    def write(self, light: FloatArray, picture: FloatArray) -> None:
        light[...] = picture

    def mask(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return mask

    def make_pass(
        self, shader: str, shape: tuple[int, int], defines: Mapping[str, int | None] | None = None, **uniforms: Any
    ) -> Pass:
        told = {FLAGS[name]: value for name, value in (defines or {}).items() if name in FLAGS}
        uniforms |= {name: True if value is None else value for name, value in told.items()}
        if shader in PLACING:
            uniforms["target"] = shape
        return Twin(TWINS[shader], shape, uniforms)

    def store(self, room: Room) -> StoredMaps:
        return Maps(room, "reference", _Map)

    def planes(self, pixels: PixelFormat) -> device.Planes:
        return Planes(pixels)

    def adapter(self, near_light: NearLight, ambient: FloatArray, most: FloatArray, white: float) -> "Adapter":
        return Adapter(near_light, ambient.astype(np.float64), most, white)

    def encoder(self, shape: tuple[int, int], response: RasterResponse, scale: float, dither: str) -> Operation:
        encode = partial(encoding.encode, colours=response.matrices, segments=response.segment_tables())
        tables, whose = response.inverse_tables(), (response.of_column, response.row_height)
        return Function(lambda light, frame: encode(light, tables, scale, dither, frame, *whose))

    def stepper(self, shape: tuple[int, int], prior: Mapping[str, NDArray[np.float32]]) -> Operation:
        step, drawn = reference.refinement_step, Prior(**prior)
        return Function(lambda k, descent, y, p, size: step(descent, y, p, size, drawn, momentum(k), OVER_RELAXATION))

    def total(self, shape: tuple[int, int]) -> Operation:
        return Function(lambda picture: reference.block_sum(picture, max(shape))[0, 0])

    def read(self, light: NDArray[Any], dtype: type) -> NDArray[Any]:
        return light.astype(dtype)

    def finish(self) -> None:
        """Returns at once: nothing runs in the background."""


class Held:
    def release(self) -> None:
        """Does nothing: arrays need no release."""


class Function(Held):
    def __init__(self, run: Callable[..., Any]) -> None:
        self.run = run


class Twin(Held):
    """A shader's CPU function and its last result."""

    def __init__(self, twin: Callable[..., FloatArray], shape: tuple[int, int], uniforms: dict[str, Any]) -> None:
        self._twin, self._shape, self._uniforms = twin, shape, uniforms
        self.target: FloatArray = np.zeros((*shape, 3))

    def set(self, **uniforms: Any) -> None:
        self._uniforms |= uniforms

    def run(self, **inputs: Any) -> FloatArray:
        self.target = self._twin(**inputs, **self._uniforms)
        return self.target

    def clear(self) -> None:
        self.target = np.zeros((*self._shape, 3))


class Maps(Held):
    """A room's maps, each stored on first use. `store` prepares a map for products."""

    weighs = False

    def __init__(self, room: Room, path: str, store: Callable[[RowMap], StoredMap]) -> None:
        self.room, self.report = room, PathReport(path, LONG_BYTES)
        self._store = store
        self._stored: dict[int, StoredMap] = {}

    def of(self, packed: RowMap) -> StoredMap:
        if id(packed) not in self._stored:
            self._stored[id(packed)] = self._store(packed)
        return self._stored[id(packed)]


class _Map(Held):
    def __init__(self, packed: RowMap) -> None:
        self.output_shape, self.source_shape = packed.output_shape, packed.source_shape
        self._rows = PreparedRows(packed)

    def product(self, combine: str = "") -> Function:
        with_base = COMBINE[combine]
        return Function(lambda source, base=None: with_base(base, self._rows.apply(source)))


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
            self._upright = reference.planes_to_linear(self._planes, self._pixels, signal)
        return self._upright


class Adapter(Held):
    """Adapts frames. `sums_of` replaces adaptation.clip_sums if given."""

    def __init__(
        self,
        near_light: NearLight,
        ambient: FloatArray,
        most: FloatArray,
        white: float,
        sums_of: SumsOf | None = None,
    ) -> None:
        self._sums_of = sums_of
        self._near_light, self._white, self._succession = near_light, white, Succession(lasting=True)
        self._limits = Limits(near_light(np.ones_like(ambient)), near_light(ambient), ambient, most)
        self._before: FloatArray = NO_TONE
        self._now: FloatArray = NO_TONE

    def set(self, adapt: float, unit: float, black_level: float) -> None:
        self._budget, self._unit, self._black_level = adapt * PERCENT, unit, black_level
        self._succession.restart()

    def advance(self, *, cut: bool, duration_s: float) -> None:
        if self._succession.advance(cut=cut, duration_s=duration_s):
            self._before = self._now

    def run(self, placed: FloatArray) -> FloatArray:
        u = reference.desired_light(placed, 0.0, 1.0, NO_TONE, self._unit, self._black_level)
        near = self._near_light(u)
        found = adaptation.tone_of(u, near, self._limits, self._white, self._budget, self._sums_of)
        weight = 0.0 if self._succession.fresh else 1 - approach(self._succession.elapsed_s)
        self._now = reference.blend(found, self._before, weight)
        self._succession.draw()
        return self._now
