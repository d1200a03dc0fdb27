"""The two ways to multiply with a room's maps on the GPU, and which of them is the faster here.

fragment : shaders/row_map.frag, everywhere.  compute : shaders/row_map.comp, OpenGL 4.3.
"""

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

import moderngl
import numpy as np

from counterlight.errors import InputError
from counterlight.gl.compute_pass import MapBuffers, supports_compute
from counterlight.gl.passes import float_texture
from counterlight.gl.row_map_pass import MapTextures
from counterlight.gl.small_map_pass import SmallBuffers, SmallTextures
from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import RowMap
from counterlight.maps.small_correction import small_correction
from counterlight.maps.small_light import SmallLight, small_light
from counterlight.maps.small_map import SmallMap, entry_bytes
from counterlight.pipeline.device import LONG_BYTES, Operation, Owner, PathReport, StoredMap
from counterlight.pipeline.room import Room

WARM_UP, FRAMES = 1, 5
SOFTWARE = ("llvmpipe", "softpipe", "swrast")


class GlMaps:
    """Puts a room's maps on the GPU for one of the paths, each when first asked for, and holds them.

    words : what takes the place of maps whose bound allows it.
    """

    def __init__(self, context: moderngl.Context, room: Room, path: str, words: "RoomWords") -> None:
        self._context, self._path, self._words, self._owner = context, path, words, Owner()
        self._stored: dict[int, StoredMap] = {}
        self.room, self.report = room, PathReport(path, words.correction_bytes, words.light_bytes)
        self.weighs = words.light is not None

    def of(self, packed: RowMap) -> StoredMap:
        if id(packed) not in self._stored:
            self._stored[id(packed)] = self._owner.own(self._store(packed))
        return self._stored[id(packed)]

    def release(self) -> None:
        self._owner.release()

    def _store(self, packed: RowMap) -> StoredMap:
        small = self._words.of(packed)
        if small is not None:
            return (SmallBuffers if self._path == "compute" else SmallTextures)(self._context, small)
        return (MapBuffers if self._path == "compute" else MapTextures)(self._context, packed)


@dataclass(frozen=True)
class RoomWords:
    """A room's maps in small words, those that are certified (player/maps/small_correction.py, small_light.py)."""

    maps: RoomMaps
    correction: SmallMap | None = None
    light: SmallLight | None = None

    @classmethod
    def of_room(cls, room: Room) -> "RoomWords":
        correction = small_correction(room.maps, room.white, room.ambient)
        light = small_light(room.maps, room.white)
        return cls(
            room.maps,
            correction.map if correction is not None and correction.certified else None,
            light if light is not None and light.certified else None,
        )

    def of(self, packed: RowMap) -> SmallMap | None:
        if packed is self.maps.correction:
            return self.correction
        return None if self.light is None else self.light.of(packed)

    @property
    def correction_bytes(self) -> float:
        return LONG_BYTES if self.correction is None else entry_bytes([self.correction])

    @property
    def light_bytes(self) -> float | None:
        return None if self.light is None else self.light.entry_bytes


def store_maps(context: moderngl.Context, room: Room, path: str) -> GlMaps:
    """A room's maps on the path asked for; "auto" measures both and keeps the faster.

    Raises InputError if "compute" is asked for and this OpenGL has none; "auto" then takes fragments.
    """
    if path == "compute" and not supports_compute(context):
        raise InputError(
            f"--path compute: needs OpenGL 4.3, found {context.info['GL_VERSION']}; use --path fragment or auto"
        )
    words = RoomWords(room.maps) if in_software(context) else RoomWords.of_room(room)
    if path == "auto" and supports_compute(context):
        return _faster(context, GlMaps(context, room, "compute", words), GlMaps(context, room, "fragment", words))
    return GlMaps(context, room, "compute" if path == "compute" else "fragment", words)


def in_software(context: moderngl.Context) -> bool:
    """Whether OpenGL runs on the CPU, where a fetch costs the same whatever its bytes, and words take longer."""
    return any(name in context.info["GL_RENDERER"].lower() for name in SOFTWARE)


def _faster(context: moderngl.Context, compute: GlMaps, fragment: GlMaps) -> GlMaps:
    """Whichever takes less time for a frame's products; the other is released."""
    try:
        fragment_ms = products_ms(context, fragment)
        try:
            compute_ms = products_ms(context, compute)
        except InputError:  # no memory for both
            compute_ms = float("inf")
    except BaseException:
        fragment.release()
        compute.release()
        raise
    kept, other = (compute, fragment) if compute_ms < fragment_ms else (fragment, compute)
    other.release()
    kept.report = replace(kept.report, fragment_ms=fragment_ms, compute_ms=compute_ms)
    return kept


def products_ms(context: moderngl.Context, stored: GlMaps) -> float:
    """Milliseconds of the products with T⁺ and, where the room can be refined, with T and Tᵀ; medians of a few."""
    maps = stored.room.maps
    measured = [maps.correction, *([] if maps.refinement is None else [maps.transport, maps.refinement.dual])]
    return sum(_product_ms(context, each) for each in map(stored.of, measured))


def _product_ms(context: moderngl.Context, stored: StoredMap) -> float:
    owner = Owner()
    try:
        product = owner.own(stored.product())
        grey = np.full((*stored.source_shape, 4), 0.5, np.float32)
        source = owner.own(float_texture(context, stored.source_shape, grey))
        return 1000 * float(np.median(list(_frame_seconds(context, product, source))[WARM_UP:]))
    finally:
        owner.release()


def _frame_seconds(context: moderngl.Context, product: Operation, source: moderngl.Texture) -> Iterable[float]:
    for _ in range(WARM_UP + FRAMES):
        context.finish()
        start = time.perf_counter()
        product.run(source)
        context.finish()
        yield time.perf_counter() - start
