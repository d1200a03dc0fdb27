"""Small outputs of every kind, written while faults strike. Each generation differs from all others.

Functions take JSON-able arguments, so that a runner (tests/faults.py) can call them, and use the product as a whole.
"""

from pathlib import Path

import numpy as np
from scipy import sparse

from counterlight import calibration
from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.files.picture_files import read_picture, write_png
from counterlight.maps import room_maps as maps
from counterlight.maps.room_maps import RoomMaps, read_maps, write_maps
from counterlight.media.decoding.media import _sequence
from counterlight.response import Response
from counterlight.tools.transport.storage import read_transport, write_transport
from counterlight.tools.transport.transport import Transport, channels
from counterlight.writing.numbered import name_of
from counterlight.writing.outputs import check_sequence
from counterlight.writing.replacing import replacing_file, replacing_sequence
from tests.rooms import random_map

SHAPE = (5, 7)
LONGEST = 6, 4  # rows of the correction map and of the transport
LINEAR = Response("linear")


def write_file(path: str, generation: int) -> None:
    with replacing_file(Path(path)) as temporary:
        temporary.write_text(f"{generation}\n" * 1000)


def file_generation(path: str) -> int | None:
    """Return which generation is there. The test fails if the file is incomplete."""
    if not Path(path).exists():
        return None
    lines = Path(path).read_text().split()
    assert len(lines) == 1000
    (generation,) = set(lines)
    return int(generation)


def write_room(folder: str, generation: int) -> None:
    pixels = SHAPE[0] * SHAPE[1]
    T = sparse.csr_array(sparse.diags_array(np.full(pixels, 1 + generation, np.float32)))
    ambient = np.full((*SHAPE, 3), generation, np.float32)
    device = Device(*SHAPE, LINEAR)
    room = Calibration(f"{generation}", "made by a test", (device,), device, ambient, np.ones(SHAPE, bool))
    with calibration.replacing(Path(folder), force=True) as stage:
        write_transport(Transport.from_matrices((T, T, T)), stage)
        calibration.write(room, stage)


def room_generation(folder: str) -> int | None:
    """Return the generation as the product reads it, even after a kill."""
    try:
        stored = calibration.read(Path(folder))
    except InputError as error:
        if "no such folder" not in str(error):
            raise
        return None
    generation = int(stored.calibration.name)
    assert (stored.calibration.ambient == generation).all()
    assert all((matrix.data == 1 + generation).all() for matrix in channels(read_transport(stored).near))
    return generation


def write_room_maps(folder: str, generation: int) -> None:
    """Write maps with random numbers seeded by the generation. Their white level states the generation."""
    rng = np.random.default_rng(generation)
    stored = calibration.read(Path(folder))
    with maps.replacing(stored) as stage:
        found = RoomMaps(
            random_map(rng, SHAPE, SHAPE, 6), random_map(rng, SHAPE, SHAPE, 4), None, None, 1.0 + generation
        )
        write_maps(found, stored, stage)


def maps_generation(folder: str) -> int | None:
    try:
        found = read_maps(calibration.read(Path(folder)))
    except InputError as error:
        if "missing" not in str(error):
            raise
        return None
    generation = int(found.white - 1)
    rng = np.random.default_rng(generation)
    for packed, longest in zip((found.correction, found.transport), LONGEST, strict=True):
        np.testing.assert_array_equal(packed.entries, random_map(rng, SHAPE, SHAPE, longest).entries)
    return generation


def write_sequence(pattern: str, generation: int) -> None:
    """Write a sequence of 3 frames, or 5 if the generation is odd."""
    check_sequence(Path(pattern))
    with replacing_sequence(Path(pattern)) as stage:
        for number in range(frames_of(generation)):
            picture = np.full((4, 6), 10 * generation + number, np.uint16)
            write_png(stage / name_of(Path(pattern).name, number), picture)


def frames_of(generation: int) -> int:
    return 5 if generation % 2 else 3


def sequence_generation(pattern: str) -> int | None:
    """Return the generation as the player finds it."""
    try:
        first, paths = _sequence(Path(pattern))
    except InputError as error:
        if "no file matches" not in str(error):
            raise
        return None
    assert first == 0
    (generation,) = {frame_generation(path, number) for number, path in enumerate(paths)}
    assert len(paths) == frames_of(generation)
    return generation


def frame_generation(path: Path, number: int) -> int:
    (value,) = set((read_picture(path).astype(int) - number).ravel())
    assert value % 10 == 0
    return int(value // 10)
