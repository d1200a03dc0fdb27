"""The interface of a backend: it holds pictures, draws passes, and multiplies with a room's maps.

gl/device.py implements it with OpenGL, cpu_renderer.py with compiled passes, reference_renderer.py with numpy. The
order of the passes is written once, in renderer.py and the modules that it uses.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError, nearest
from counterlight.maps.room_maps import MapChain
from counterlight.maps.row_map import RowMap
from counterlight.media.frames import PixelFormat
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.room import Room
from counterlight.response import RasterResponse

BACKENDS = ("auto", "gl", "cpu")
SHADERS, ENTRIES = ("auto", "fragment", "compute"), ("auto", "16", "words")
LONG_BYTES = 16  # an entry: three weights of 32 bits and an index
Light: TypeAlias = Any  # a picture as its device holds it: a texture or an array
NearLight: TypeAlias = Callable[[Light], Light]  # b -> b without the far light of the compensated picture
T = TypeVar("T")


@dataclass(frozen=True)
class GpuPath:
    """The way in which a GPU multiplies with a room's maps.

    shader : of SHADERS: shaders/*.frag, available everywhere, or shaders/*.comp, which need OpenGL 4.3.
    entries : of ENTRIES: 16 bytes each, or T and Tᵀ in words of 4 bytes. In both, "auto" takes what is fastest.
    """

    shader: str = "fragment"
    entries: str = "16"

    def __post_init__(self) -> None:
        for name, value, known in (("shader", self.shader, SHADERS), ("entries", self.entries, ENTRIES)):
            if value not in known:
                raise InputError(f"{name} {value!r}: expected one of {', '.join(known)}{nearest(str(value), known)}")

    def __str__(self) -> str:
        return self.shader if self.entries == "16" else f"{self.shader}-{self.entries}"


EVERYWHERE = GpuPath()


@dataclass(frozen=True)
class PathReport:
    """A renderer's way of multiplying with the room's maps.

    name : str() of a GpuPath without "auto", or "cpu" or "reference".
    entry_bytes : bytes per entry of the correction map.
    light_bytes : mean bytes per entry of T if T and Tᵀ are packed in words; None otherwise.
    measured : milliseconds of a frame's products on each path, measured at startup; empty without a measurement.
    """

    name: str
    entry_bytes: int
    light_bytes: float | None = None
    measured: Mapping[str, float] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return values for JSON; times in milliseconds, rounded to microseconds."""
        values = {"name": self.name, "entry_bytes": self.entry_bytes, "light_bytes": self.light_bytes}
        values |= {f"{name}_ms": ms for name, ms in self.measured.items()}
        shown = {key: round(value, 3) if isinstance(value, float) else value for key, value in values.items()}
        return {key: value for key, value in shown.items() if value is not None}

    def __str__(self) -> str:
        measured = ", ".join(f"{name} {ms:.2f} ms" for name, ms in self.measured.items())
        light = "" if self.light_bytes is None else f", {self.light_bytes:.3g} of T"
        return f"{self.name}, {self.entry_bytes} bytes an entry{light}{measured and '; '}{measured}"


class Owner:
    """Holds resources and releases them in reverse order. Arrays need no release."""

    def __init__(self) -> None:
        self._owned: list[Any] = []

    def own(self, resource: T) -> T:
        if hasattr(resource, "release"):
            self._owned.append(resource)
        return resource

    def give_up(self, resource: object) -> None:
        """Release one resource now; does nothing for None."""
        for index, owned in enumerate(self._owned):
            if owned is resource:
                self._owned.pop(index).release()
                return

    def release(self) -> None:
        while self._owned:
            self._owned.pop().release()


class Operation(Protocol):
    """An object that is built once and runs every frame."""

    @property
    def run(self) -> Callable[..., Any]: ...

    def release(self) -> None: ...


class Pass(Operation, Protocol):
    """One shader, or its CPU function: run(**pictures) draws and returns its target."""

    @property
    def target(self) -> Light: ...

    def set(self, **uniforms: Any) -> None:
        """Set uniforms by name."""

    def clear(self) -> None:
        """Make the target black."""


class StoredMap(Protocol):
    """A row map on its device; several products may share it."""

    @property
    def output_shape(self) -> tuple[int, int]: ...

    @property
    def source_shape(self) -> tuple[int, int]: ...

    def product(self, combine: str = "") -> Operation:
        """Return an operation with run(source, base) -> Σ weights · source, combined with the optional base.

        combine : "" for the product alone, "ADD_TO_BASE", "SUBTRACT_FROM_BASE" or "CLAMP". If the maps weigh, the last
            part of T also accepts "WEIGHED_RESIDUAL", which makes the source of Tᵀ.
        """

    def release(self) -> None: ...


class StoredMaps(Protocol):
    """A room's maps, each stored on first use.

    weighs : whether the maps of TᵀW take a weighted residual, w C ∘ (b − T p) (counterlight.maps.small_map).
    """

    room: Room
    report: PathReport
    weighs: bool

    def of(self, packed: RowMap) -> StoredMap: ...

    def release(self) -> None: ...


class ChainPass:
    """A chain of far or blurred light: target = base ± scatter · (mix ·) gather · source."""

    def __init__(self, stored: StoredMaps, chain: MapChain, combine: str) -> None:
        *first, last = chain.factors
        self._first = [stored.of(factor).product() for factor in first]
        self._last = stored.of(last).product(combine)

    def run(self, source: Light, base: Light) -> Light:
        for product in self._first:
            source = product.run(source)
        return self._last.run(source, base)

    def release(self) -> None:
        for product in (*self._first, self._last):
            product.release()


class Planes(Operation, Protocol):
    """The planes of one pixel format: run() -> upright linear picture."""

    def adjust(self, adjustments: Adjustments) -> None:
        """Apply brightness, contrast, gamma and saturation; they do not change radiance, which has no codes."""

    def upload(self, planes: Sequence[NDArray[Any]]) -> None: ...


class Adapter(Operation, Protocol):
    """run(placed picture) -> (s, o) of a frame (player/pipeline/content.py)."""

    def set(self, adapt: float, unit: float, black_level: float) -> None:
        """Set the parameters of the adaptation.

        adapt : percent of the light that may clip.
        unit : share of white that a picture's 1 stands for.
        black_level : share of white that black asks for.
        """

    def advance(self, *, cut: bool, duration_s: float) -> None: ...


class Device(Protocol):
    """Makes pictures and passes. The caller releases what a method made; shapes are (height, width)."""

    def picture(self, picture: NDArray[np.floating]) -> Light:
        """Return a device picture of an array (height, width, 3)."""

    def write(self, light: Light, picture: NDArray[np.floating]) -> None:
        """Overwrite a picture made by `picture`."""

    def mask(self, mask: NDArray[np.bool_]) -> Light: ...

    def make_pass(
        self, shader: str, shape: tuple[int, int], defines: Mapping[str, int | None] | None = None, **uniforms: Any
    ) -> Pass: ...

    def store(self, room: Room) -> StoredMaps: ...

    def planes(self, pixels: PixelFormat) -> Planes: ...

    def adapter(self, near_light: NearLight, ambient: Light, most: Light, white: float) -> Adapter: ...

    def encoder(self, shape: tuple[int, int], response: RasterResponse, scale: float, dither: str) -> Operation:
        """Return an operation with run(light, frame) -> 8-bit codes through the inverse response of each column."""

    def stepper(self, shape: tuple[int, int], prior: Mapping[str, Light]) -> Operation:
        """Return an operation with run(step, descent, y, p, step_size) -> next p and y.

        The results stay valid during the following step, and the step after that overwrites them.
        """

    def total(self, shape: tuple[int, int]) -> Operation:
        """Return an operation with run(picture) -> its sum, (3,) float64; run waits for the result."""

    def read(self, light: Light, dtype: type) -> NDArray[Any]:
        """Return a picture's three channels, (height, width, 3); waits for the device."""

    def finish(self) -> None: ...
