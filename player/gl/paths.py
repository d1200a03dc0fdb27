"""Stores a room's maps on the GPU for one path (shader and format of entries).

`auto` measures the paths and keeps the fastest.
"""

import time
from collections.abc import Iterable
from dataclasses import replace

import moderngl
import numpy as np

from counterlight.errors import InputError
from counterlight.gl.gpu_maps import MapBuffers, MapTextures, WordBuffers, WordTextures, supports_compute
from counterlight.gl.passes import float_texture
from counterlight.maps.row_map import RowMap
from counterlight.maps.small_map import WORD_BYTES
from counterlight.pipeline.device import LONG_BYTES, GpuPath, Owner, Owning, PathReport, Product, StoredMap
from counterlight.pipeline.room import Room

WARM_UP, FRAMES = 1, 5
STORES = {"fragment": (MapTextures, WordTextures), "compute": (MapBuffers, WordBuffers)}


class GlMaps(Owning):
    """Holds a room's maps on the GPU for one path; each is uploaded on first use."""

    def __init__(self, context: moderngl.Context, room: Room, path: GpuPath) -> None:
        self._context, self._owner = context, Owner()
        self._words = room.maps.in_words(room.white) if path.entries == "words" else {}
        self._stored: dict[int, StoredMap[moderngl.Texture]] = {}
        self.weighs = id(room.maps.transport) in self._words
        self.room, self.path = room, path
        self.report = PathReport(str(path), LONG_BYTES, self._light_bytes() if self.weighs else None)

    def of(self, packed: RowMap) -> StoredMap[moderngl.Texture]:
        if id(packed) not in self._stored:
            self._stored[id(packed)] = self._owner.own(self._store(packed))
        return self._stored[id(packed)]

    def _store(self, packed: RowMap) -> StoredMap[moderngl.Texture]:
        of_entries, of_words = STORES[self.path.shader]
        small = self._words.get(id(packed))
        return of_entries(self._context, packed) if small is None else of_words(self._context, small)

    def _light_bytes(self) -> float:
        """Return the mean bytes per entry of T."""
        transport = self.room.maps.transport
        return WORD_BYTES * self._words[id(transport)].runs.words.size / max(transport.count, 1)


def store_maps(context: moderngl.Context, room: Room, path: GpuPath) -> GlMaps:
    """Return a room's maps on the requested path. "auto" measures the shaders first, then words with the faster shader.

    Raises InputError if a requested shader or words are missing; "auto" skips what is missing.
    """
    if path.shader == "compute" and not supports_compute(context):
        raise InputError(
            f"--shader compute: needs OpenGL 4.3, found {context.info['GL_VERSION']}; use --shader fragment or auto"
        )
    has_words = bool(room.maps.in_words(room.white))
    if path.entries == "words" and not has_words:
        raise InputError(
            "--entries words: the room has no words of 4 bytes for this white level, or is played without refinement, "
            "which they are for; build it anew, or use --entries auto"
        )
    first, *other = [path.shader] if path.shader != "auto" else ["fragment", "compute"]
    entries = "16" if path.entries == "auto" else path.entries
    fastest = GlMaps(context, room, GpuPath(first, entries))
    if other and supports_compute(context):
        fastest = _faster(context, fastest, GlMaps(context, room, GpuPath("compute", entries)))
    if path.entries == "auto" and has_words:
        fastest = _faster(context, fastest, GlMaps(context, room, GpuPath(fastest.path.shader, "words")))
    return fastest


def _faster(context: moderngl.Context, one: GlMaps, other: GlMaps) -> GlMaps:
    """Return the maps whose products take less time per frame, with all measurements so far; release the other maps."""
    try:
        known = dict(one.report.measured) or {one.report.name: products_ms(context, one)}
        try:
            known = known | {other.report.name: products_ms(context, other)}
        except InputError:  # the GPU has not enough memory for both maps
            known = known | {other.report.name: float("inf")}
    except BaseException:
        one.release()
        other.release()
        raise
    kept, left = (other, one) if known[other.report.name] < known[one.report.name] else (one, other)
    left.release()
    kept.report = replace(kept.report, measured=known)
    return kept


def products_ms(context: moderngl.Context, stored: GlMaps) -> float:
    """Return milliseconds of the products with T⁺ and, if the room has refinement, with T and Tᵀ; sums of medians."""
    maps = stored.room.maps
    measured = [maps.correction, *([] if maps.refinement is None else [maps.transport, maps.refinement.dual])]
    return sum(_product_ms(context, each) for each in map(stored.of, measured))


def _product_ms(context: moderngl.Context, stored: StoredMap[moderngl.Texture]) -> float:
    owner = Owner()
    try:
        product = owner.own(stored.product())
        grey = np.full((*stored.source_shape, 4), 0.5, np.float32)
        source = owner.own(float_texture(context, stored.source_shape, grey))
        return 1000 * float(np.median(list(_frame_seconds(context, product, source))[WARM_UP:]))
    finally:
        owner.release()


def _frame_seconds(
    context: moderngl.Context, product: Product[moderngl.Texture], source: moderngl.Texture
) -> Iterable[float]:
    for _ in range(WARM_UP + FRAMES):
        context.finish()
        start = time.perf_counter()
        product.run(source)
        context.finish()
        yield time.perf_counter() - start
