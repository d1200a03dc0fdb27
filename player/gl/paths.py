"""The two ways to multiply with a room's maps on the GPU, and which of them is the faster here.

fragment : shaders/row_map.frag, everywhere.  compute : shaders/row_map.comp, OpenGL 4.3.
"""

import time
from collections.abc import Iterable
from dataclasses import replace

import moderngl
import numpy as np

from counterlight.errors import InputError
from counterlight.gl.compute_pass import MapBuffers, supports_compute
from counterlight.gl.passes import float_texture
from counterlight.gl.row_map_pass import MapTextures
from counterlight.gl.small_map_pass import SmallBuffers, SmallTextures
from counterlight.maps.row_map import RowMap
from counterlight.maps.short_map import rounding_of
from counterlight.maps.sliced_map import spans_fit
from counterlight.maps.small_light import SmallLight, small_light
from counterlight.pipeline.device import LONG_BYTES, SHORT_BYTES, Operation, Owner, PathReport, StoredMap
from counterlight.pipeline.room import Room

WARM_UP, FRAMES = 1, 5


class GlMaps:
    """Puts a room's maps on the GPU for one of the paths, each when first asked for, and holds them.

    scale : of 16-bit weights for the correction map, None for 32-bit ones (player/maps/short_map.py).
    small : what takes the place of T's and Tᵀ's maps (player/maps/small_light.py).
    """

    def __init__(
        self,
        context: moderngl.Context,
        room: Room,
        path: str,
        scale: np.float32 | None = None,
        small: SmallLight | None = None,
    ) -> None:
        self._context, self._path, self._owner = context, path, Owner()
        self._short = {} if scale is None else {id(room.maps.correction): scale}
        self._small, self.weighs = small, small is not None
        self._stored: dict[int, StoredMap] = {}
        light = None if small is None else small.entry_bytes
        self.room, self.report = room, PathReport(path, LONG_BYTES if scale is None else SHORT_BYTES, light)

    def of(self, packed: RowMap) -> StoredMap:
        if id(packed) not in self._stored:
            self._stored[id(packed)] = self._owner.own(self._store(packed))
        return self._stored[id(packed)]

    def release(self) -> None:
        self._owner.release()

    def _store(self, packed: RowMap) -> StoredMap:
        small = None if self._small is None else self._small.of(packed)
        if small is not None:
            return (SmallBuffers if self._path == "compute" else SmallTextures)(self._context, small)
        if self._path == "compute":
            return MapBuffers(self._context, packed, self._short.get(id(packed)))
        return MapTextures(self._context, packed)


def store_maps(context: moderngl.Context, room: Room, path: str) -> GlMaps:
    """A room's maps on the path asked for; "auto" measures both and keeps the faster.

    Raises InputError if "compute" is asked for and this OpenGL has none; "auto" then takes fragments.
    """
    if path == "fragment" or (path == "auto" and not supports_compute(context)):
        return GlMaps(context, room, "fragment", small=certified_light(room))
    if not supports_compute(context):
        raise InputError(
            f"--path compute: needs OpenGL 4.3, found {context.info['GL_VERSION']}; use --path fragment or auto"
        )
    small = certified_light(room)
    compute = GlMaps(context, room, "compute", short_scale(room), small)
    return _faster(context, compute, GlMaps(context, room, "fragment", small=small)) if path == "auto" else compute


def certified_light(room: Room) -> SmallLight | None:
    """T and Tᵀ in small words; None where they would change the camera's picture by too much."""
    small = small_light(room.maps, room.white)
    return small if small is not None and small.certified else None


def short_scale(room: Room) -> np.float32 | None:
    """For entries of 8 bytes; None if the correction map's bound or its rows' extent do not allow them."""
    rounding = rounding_of(room.maps, room.white, room.ambient)
    certified = rounding is not None and rounding.certified and spans_fit(room.maps.correction)
    return rounding.scale if rounding is not None and certified else None


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
