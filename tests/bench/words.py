"""What a frame reads of its maps in entries of 16 bytes and in words, in every shipped room; the time of one."""

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import moderngl
import numpy as np

from counterlight import calibration
from counterlight.gl.context import headless_context
from counterlight.gl.passes import picture_texture
from counterlight.gl.paths import GlMaps, RoomWords
from counterlight.maps.row_map import RowMap
from counterlight.pipeline.refinement import default_start, default_steps
from counterlight.pipeline.room import Room
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.inverse.inverse import TRUNCATED, InverseOptions
from counterlight.tools.inverse.room import BuiltRoom, build_maps
from counterlight.tools.shipped import shipped_scenes
from counterlight.tools.transport.storage import read_transport
from tests.bench.rows import median_ms
from tests.programs import succeed

CAMERA, PROJECTOR = "128x96", "96x72"
TIMED = "glass"
GOAL = 0.4
ENTRY, LOOKUP = 16, 12  # bytes, of long maps
CUT = 1000  # --max-cluster: whole inverses of glass or skull would take minutes
AFTER = InverseOptions(max_cluster=CUT)
BEFORE = replace(AFTER, max_error=AFTER.max_error / TRUNCATED)  # leaves out as much as may be lost in all


def words() -> Iterator[str]:
    """Bytes a frame at the default number of steps, from the maps alone: entries of 16 bytes, words, and the share."""
    for name in shipped_scenes():
        with tempfile.TemporaryDirectory() as folder:
            succeed("simulate", name, "-o", Path(folder) / name, "--camera", CAMERA, "--projector", PROJECTOR)
            stored = calibration.read(Path(folder) / name)
            tier = tier_of(stored.calibration, read_transport(stored), "auto")
        before, after = build_maps(tier, BEFORE), build_maps(tier, AFTER)
        yield line(name, before, after)
        if name == TIMED:
            yield from timed(after)


def line(name: str, before: BuiltRoom, after: BuiltRoom) -> str:
    """before, after : of one certified error, without and with a share of it for words."""
    start = default_start(before.maps.correction_in_steps)
    steps = default_steps(start)
    made = RoomWords.of_room(room_of(after))
    long_bytes, small_bytes = frame_bytes(before, start, steps, None), frame_bytes(after, start, steps, made)
    ratio = small_bytes / long_bytes
    light = "-" if made.light is None else f"{made.light.entry_bytes:.1f} bytes an entry, {made.light.change:.2f} codes"
    return (
        f"  {name:<13}{start:<16}{steps} steps: {long_bytes / 1e6:7.2f} -> {small_bytes / 1e6:6.2f} MB, {ratio:4.0%}"
        f"{'' if ratio <= GOAL else ' (goal 40 %)'}; T {light}; T⁺ {made.correction_bytes:.1f} bytes"
    )


def frame_bytes(built: BuiltRoom, start: str, steps: int, made: RoomWords | None) -> int:
    """What the products of a frame read, each byte of a map once a product."""
    maps = built.maps
    assert maps.refinement is not None
    first = [maps.refinement.direct] if start == "previous-direct" else [maps.correction]
    if maps.undo is not None and start == "previous":
        first += list(vars(maps.undo).values())
    step = [maps.transport, maps.refinement.dual]
    for chain in (maps.far, maps.refinement.far_dual):
        step += [] if chain is None else list(vars(chain).values())
    return sum(map_bytes(each, made) for each in first) + steps * sum(map_bytes(each, made) for each in step)


def map_bytes(packed: RowMap, made: RoomWords | None) -> int:
    small = None if made is None else made.of(packed)
    rows = packed.output_shape[0] * packed.output_shape[1]
    return ENTRY * packed.count + LOOKUP * rows if small is None else small.nbytes


def timed(built: BuiltRoom) -> Iterator[str]:
    """T p and Tᵀ r of one room on the fragment path, in words over in entries of 16 bytes."""
    room = room_of(built)
    with headless_context() as context:
        long_ms, small_ms = (near_ms(context, room, made) for made in (RoomWords(room.maps), RoomWords.of_room(room)))
        yield f"  {'':<13}{context.info['GL_RENDERER']}: T p and Tᵀ r take {small_ms / long_ms:.2f} of the time"


def near_ms(context: moderngl.Context, room: Room, made: RoomWords) -> float:
    stored = GlMaps(context, room, "fragment", made)
    assert room.maps.refinement is not None
    near = [stored.of(packed) for packed in (room.maps.transport, room.maps.refinement.dual)]
    products = [each.product() for each in near]
    sources = [picture_texture(context, np.full((*each.source_shape, 3), 0.5, np.float32)) for each in near]

    def work() -> None:
        for product, source in zip(products, sources, strict=True):
            product.run(source)
        context.finish()

    result = median_ms(work)
    for resource in (*products, *sources, stored):
        resource.release()
    return result


def room_of(built: BuiltRoom) -> Room:
    return Room(built.calibration, built.maps, built.maps.white)
