"""Records the passes of a frame in the order in which they run, as docs/architecture.md lists them."""

from typing import Any

from counterlight.maps.room_maps import CHAINS
from counterlight.maps.row_map import RowMap
from counterlight.media.frames import PixelFormat
from counterlight.passes.drawing import CHANNELS, Array, Pass
from counterlight.passes.refinement_step import Ties
from counterlight.pipeline.cpu_renderer import CpuCanvas, CpuDevice
from counterlight.pipeline.device import StoredMaps
from counterlight.pipeline.renderer import Renderer
from counterlight.pipeline.room import Room
from counterlight.response import RasterResponse


class Recorded:
    """Wrapper that records the name of an object before each `run`."""

    def __init__(self, of: Any, name: str, noted: list[str]) -> None:
        self._of, self._name, self._noted = of, name, noted

    def __getattr__(self, name: str) -> Any:
        return getattr(self._of, name)

    def run(self, *pictures: Any, **named: Any) -> Any:
        self._noted.append(self._name)
        return self._of.run(*pictures, **named)


class RecordedMaps:
    """Wrapper of a room's maps that records each product by the map's name."""

    def __init__(self, of: StoredMaps, noted: list[str]) -> None:
        self._of, self._noted = of, noted
        maps = of.room.maps
        self._names = {id(packed): name for name, packed in maps.named().items()}
        if maps.undo is not None:  # the scatter of `undo` may be the same map as the far light's scatter
            self._names |= {id(part): name for part, name in zip(maps.undo.factors, CHAINS["undo"], strict=True)}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._of, name)

    def of(self, packed: RowMap) -> Any:
        stored, name = self._of.of(packed), self._names[id(packed)]
        noted = self._noted

        class Map:
            output_shape, source_shape = stored.output_shape, stored.source_shape
            release = staticmethod(stored.release)

            @staticmethod
            def product(combine: str = "") -> Recorded:
                return Recorded(stored.product(combine), f"map {name.replace('.', 'correction')}", noted)

        return Map()


class RecordedCanvas(CpuCanvas):
    """Canvas that records the module of each pass."""

    def __init__(self, shape: tuple[int, int], channels: int, noted: list[str]) -> None:
        super().__init__(shape, channels)
        self._noted = noted

    def draw(self, made: Pass[Array]) -> Array:
        self._noted.append(type(made).__module__.rpartition(".")[2])
        return super().draw(made)


class TracingDevice(CpuDevice):
    """CPU device; `noted` lists the passes that have run."""

    def __init__(self) -> None:
        self.noted: list[str] = []

    def canvas(self, shape: tuple[int, int], channels: int = CHANNELS) -> CpuCanvas:
        return RecordedCanvas(shape, channels, self.noted)

    def store(self, room: Room) -> Any:
        return RecordedMaps(super().store(room), self.noted)

    def planes(self, pixels: PixelFormat) -> Any:
        return Recorded(super().planes(pixels), "planes_to_linear", self.noted)

    def encoder(self, shape: tuple[int, int], response: RasterResponse, scale: float, dither: str) -> Any:
        return Recorded(super().encoder(shape, response, scale, dither), "encode", self.noted)

    def stepper(self, shape: tuple[int, int], prior: Ties[Array]) -> Any:
        return Recorded(super().stepper(shape, prior), "refinement_step", self.noted)


def trace(room: Room, frame: Any, steps: int) -> list[str]:
    """Passes of the second of two equal frames; the first frame fills caches that later frames use."""
    device = TracingDevice()
    renderer = Renderer(device, room)
    renderer.open(frame.format)
    for _ in range(2):
        renderer.upload(frame)
        device.noted.clear()
        renderer.render("projector", compensate=True, steps=steps)
    renderer.release()
    return device.noted
