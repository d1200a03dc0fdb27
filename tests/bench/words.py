"""Map data per frame in entries of 16 bytes and in words, in every shipped room; frame time in one room."""

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from counterlight import calibration
from counterlight.gl.context import headless_context
from counterlight.gl.paths import GlMaps, products_ms
from counterlight.maps.room_maps import RoomMaps
from counterlight.maps.row_map import RowMap
from counterlight.maps.word_map import WordMap
from counterlight.pipeline.device import GpuPath
from counterlight.pipeline.room import Room
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.inverse.build import BuiltRoom, build_maps
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.inverse.recommendation import Recommendation
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.transport.storage import read_transport
from tests.programs import succeed

CAMERA, PROJECTOR = "128x96", "96x72"
TIMED = "glass"
COLUMNS = (
    "room",
    "T⁺",
    "its entries, millions",
    "start",
    "steps",
    "MB in entries of 16 bytes",
    "MB in words",
    "share",
    "of the change allowed",
)
ENTRY, LOOKUP = 16, 12  # bytes of an entry and of a row's look-up, in maps of 16-byte entries


def words() -> Iterator[str]:
    """Bytes per frame by default in each room, from the maps alone: entries of 16 bytes, words, their ratio."""
    yield f"| {' | '.join(COLUMNS)} |"
    yield "|---" * len(COLUMNS) + "|"
    products: list[str] = []
    for name in shipped_scenes():
        with tempfile.TemporaryDirectory() as folder:
            succeed("simulate", name, "-o", Path(folder) / name, "--camera", CAMERA, "--projector", PROJECTOR)
            stored = calibration.read(Path(folder) / name)
            tier = tier_of(stored.calibration, read_transport(stored), "auto")
        built = build_maps(tier, InverseOptions())
        yield line(name, built)
        if name == TIMED:
            products += timed(Room(built.calibration, built.maps, built.maps.white))
    yield from products


def line(name: str, built: BuiltRoom) -> str:
    """Returns a row of docs/tables/words.md."""
    maps, found = built.maps, built.recommendation
    assert found is not None
    long_bytes, small_bytes = (frame_bytes(maps, found, made) for made in ({}, maps.in_words(maps.white)))
    used = "none" if maps.words is None else f"{maps.words.used:.2f}"
    sizes = f"{long_bytes / 1e6:.1f} | {small_bytes / 1e6:.1f} | {100 * small_bytes / long_bytes:.0f} %"
    inverse = f"{built.inverse.chosen} | {maps.correction.count / 1e6:.2f}"
    return f"| {name} | {inverse} | {found.start} | {found.steps} | {sizes} | {used} |"


def frame_bytes(maps: RoomMaps, played: Recommendation, words: Mapping[int, WordMap]) -> int:
    """Returns the bytes that the products of a frame read, with each byte of a map once per product."""
    assert maps.refinement is not None
    direct = played.start == "previous-direct"
    first = [maps.refinement.direct] if direct else [maps.correction, *([] if maps.undo is None else maps.undo.factors)]
    others = [part for chain in (*maps.chains, *maps.refinement.chains) for part in chain.factors]
    step = [maps.transport, maps.refinement.dual, *others]
    return sum(map_bytes(each, words) for each in first) + played.steps * sum(map_bytes(each, words) for each in step)


def map_bytes(packed: RowMap, words: Mapping[int, WordMap]) -> int:
    small, rows = words.get(id(packed)), packed.output_shape[0] * packed.output_shape[1]
    return ENTRY * packed.count + LOOKUP * rows if small is None else small.nbytes


def timed(room: Room) -> Iterator[str]:
    """Yield how long a frame's products take in words, relative to entries of 16 bytes, in one room."""
    with headless_context() as context:
        stored = [GlMaps(context, room, path) for path in (GpuPath(), GpuPath(entries="words"))]
        long_ms, small_ms = (products_ms(context, each) for each in stored)
        yield f"{TIMED}: {context.info['GL_RENDERER']}: products take {small_ms / long_ms:.2f} of the time in words"
        for each in stored:
            each.release()
