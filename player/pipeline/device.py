"""The interface of a backend: it holds pictures, draws passes (counterlight.passes), and multiplies with a room's maps.

gl/device.py implements it with OpenGL, cpu_renderer.py with the passes' CPU functions. The order of the passes is
written once, in renderer.py and the modules that it uses. `Picture` is a picture as the backend holds it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError, nearest
from counterlight.maps.room_maps import MapChain
from counterlight.maps.row_map import RowMap
from counterlight.media.frames import PixelFormat
from counterlight.passes.drawing import CHANNELS, Canvas, Picture
from counterlight.passes.product import Combining
from counterlight.passes.refinement_step import Ties
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.room import Room
from counterlight.response import RasterResponse

BACKENDS = ("auto", "gl", "cpu")
SHADERS, ENTRIES = ("auto", "fragment", "compute"), ("auto", "16", "words")
LONG_BYTES = 16  # an entry: three weights of 32 bits and an index
NearLight: TypeAlias = Callable[[Picture], Picture]  # b -> b without the far light of the compensated picture
T = TypeVar("T")
Drawn = TypeVar("Drawn", covariant=True)  # `Picture` where a protocol only returns it
Taken = TypeVar("Taken", contravariant=True)  # `Picture` where a protocol only takes it


@dataclass(frozen=True)
class GpuPath:
    """The way in which a GPU multiplies with a room's maps.

    shader : "fragment" (shaders/*.frag, OpenGL 3.3), "compute" (shaders/*.comp, OpenGL 4.3), or "auto".
    entries : "16" (bytes per entry), "words" (T and Tᵀ in words of 4 bytes), or "auto".

    "auto" measures the ways at startup and keeps the fastest.
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

    name : str() of a GpuPath without "auto", or "cpu".
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
    """Holds resources and releases them in reverse order. Arrays need no release.

    A `with` block releases them only if the block fails.
    """

    def __init__(self) -> None:
        self._owned: list[Any] = []

    def own(self, resource: T) -> T:
        if hasattr(resource, "release"):
            self._owned.append(resource)
        return resource

    def give_up(self, resource: object) -> None:
        """Release one resource at once; does nothing for None."""
        for index, owned in enumerate(self._owned):
            if owned is resource:
                self._owned.pop(index).release()
                return

    def release(self) -> None:
        while self._owned:
            self._owned.pop().release()

    def __enter__(self) -> None: ...

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            self.release()


class Owning:
    """Holds its resources in `_owner`."""

    _owner: Owner

    def release(self) -> None:
        self._owner.release()


class Product(Protocol[Picture]):
    """A product with a row map that is prepared once and runs every frame."""

    def run(self, source: Picture, base: Picture | None = None) -> Picture:
        """Return Σ weights · source, combined with the base; valid until the next run."""

    def release(self) -> None: ...


class StoredMap(Protocol[Picture]):
    """A row map on its device; several products may share it."""

    @property
    def output_shape(self) -> tuple[int, int]: ...

    @property
    def source_shape(self) -> tuple[int, int]: ...

    def product(self, combining: Combining = "") -> Product[Picture]:
        """Return a product. If the maps weigh, the last part of T can compute "WEIGHED_RESIDUAL", the source of Tᵀ."""

    def release(self) -> None: ...


class StoredMaps(Protocol[Picture]):
    """A room's maps, each stored on first use.

    weighs : whether the maps of TᵀW take a weighted residual, w C ∘ (b − T p) (counterlight.maps.small_map).
    """

    room: Room
    report: PathReport
    weighs: bool

    def of(self, packed: RowMap) -> StoredMap[Picture]: ...

    def release(self) -> None: ...


class ChainPass(Generic[Picture]):
    """A chain of far or blurred light: target = base ± scatter · (mix ·) gather · source."""

    def __init__(self, stored: StoredMaps[Picture], chain: MapChain, combining: Combining) -> None:
        *first, last = chain.factors
        self._first = [stored.of(factor).product() for factor in first]
        self._last = stored.of(last).product(combining)

    def run(self, source: Picture, base: Picture) -> Picture:
        for product in self._first:
            source = product.run(source)
        return self._last.run(source, base)

    def release(self) -> None:
        for product in (*self._first, self._last):
            product.release()


class SumPass(Owning, Generic[Picture]):
    """A near map plus chains: target = base ± (near + Σ chain) · source.

    combining : how the near map, and each chain, is combined with the result before it.
    """

    def __init__(
        self, stored: StoredMaps[Picture], near: RowMap, chains: Sequence[MapChain], combining: Sequence[Combining]
    ) -> None:
        self._owner = Owner()
        self._near = self._owner.own(stored.of(near).product(combining[0]))
        pairs = zip(chains, combining[1:], strict=True)
        self._chains = [self._owner.own(ChainPass(stored, chain, how)) for chain, how in pairs]

    def run(self, source: Picture, base: Picture | None = None) -> Picture:
        target = self._near.run(source, base)
        for chain in self._chains:
            target = chain.run(source, target)
        return target


class Planes(Protocol[Drawn]):
    """The planes of one pixel format, and the pass planes_to_linear."""

    def adjust(self, adjustments: Adjustments) -> None:
        """Apply brightness, contrast, gamma and saturation; they do not change radiance, which has no codes."""

    def upload(self, planes: Sequence[NDArray[Any]]) -> None: ...

    def run(self) -> Drawn:
        """Return the upright linear picture."""

    def release(self) -> None: ...


class Adapter(Protocol[Picture]):
    """The passes of the adaptation (counterlight.passes.adaptation)."""

    def set(self, adapt: float, unit: float, black_level: float) -> None:
        """Set the parameters of the adaptation.

        adapt : percent of the light that may be clipped.
        unit : share of white that a picture's 1 stands for.
        black_level : share of white that black stands for.
        """

    def advance(self, *, cut: bool, duration_s: float) -> None: ...

    def run(self, placed: Picture) -> Picture:
        """Return (s, o) of a frame (player/pipeline/content.py)."""

    def release(self) -> None: ...


class Encoder(Protocol[Picture]):
    """The pass encode."""

    def run(self, light: Picture, frame: int) -> Picture:
        """Return 8-bit codes through the inverse response of each column."""

    def release(self) -> None: ...


class Stepper(Protocol[Picture]):
    """The pass refinement_step."""

    def run(self, step: int, descent: Picture, y: Picture, p: Picture, step_size: Picture) -> tuple[Picture, Picture]:
        """Return the next p and y. They stay valid during the following step; the step after that overwrites them."""

    def release(self) -> None: ...


class Total(Protocol[Taken]):
    def run(self, picture: Taken) -> NDArray[np.float64]:
        """Return the sum of a picture, (3,) float64; waits for the result."""

    def release(self) -> None: ...


class Device(Protocol[Picture]):
    """Makes pictures and draws passes. The caller releases the results of a method; shapes are (height, width)."""

    def picture(self, picture: NDArray[np.floating]) -> Picture:
        """Return a device picture of an array (height, width, 3)."""

    def write(self, light: Picture, picture: NDArray[np.floating]) -> None:
        """Overwrite a picture made by `picture`."""

    def mask(self, mask: NDArray[np.bool_]) -> Picture: ...

    def canvas(self, shape: tuple[int, int], channels: int = CHANNELS) -> Canvas[Picture]:
        """Return a black picture that passes are drawn into."""

    def store(self, room: Room) -> StoredMaps[Picture]: ...

    def planes(self, pixels: PixelFormat) -> Planes[Picture]: ...

    def adapter(
        self, near_light: NearLight[Picture], ambient: Picture, most: Picture, white: float
    ) -> Adapter[Picture]: ...

    def encoder(self, shape: tuple[int, int], response: RasterResponse, scale: float, dither: str) -> Encoder[Picture]:
        """Return an encoder. scale : light of a white pixel. dither : one of DITHERS of counterlight.passes.encode."""

    def stepper(self, shape: tuple[int, int], prior: Ties[Picture]) -> Stepper[Picture]: ...

    def total(self, shape: tuple[int, int]) -> Total[Picture]: ...

    def read(self, light: Picture, dtype: type) -> NDArray[Any]:
        """Return a picture's three channels, (height, width, 3); waits for the device."""

    def finish(self) -> None: ...

    def release(self) -> None:
        """Release the resources that the device keeps for later draws."""
