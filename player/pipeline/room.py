"""A room as it is played in: its calibration, its maps, and how they are used."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from counterlight import calibration as calibrations
from counterlight.calibration import Calibration, StoredCalibration
from counterlight.errors import InputError
from counterlight.files.generation import read_steadily
from counterlight.maps import room_maps as maps
from counterlight.maps.room_maps import RoomMaps
from counterlight.pipeline.refinement import default_start, default_steps

DITHERS = ("ordered", "noise", "none")


@dataclass(frozen=True)
class Room:
    """What a renderer needs to know of a room.

    white : camera radiance of a white picture, in each channel.  dither : one of DITHERS.
    start : one of counterlight.pipeline.refinement.STARTS, where refinement begins.
    """

    calibration: Calibration
    maps: RoomMaps
    white: float
    dither: str = "ordered"
    start: str = "previous"

    @cached_property
    def ambient(self) -> NDArray[np.float32]:
        """Q e: light without the projector, in screen primaries, (camera height, camera width, 3)."""
        return self.maps.mixing.on_screen(self.calibration.ambient).astype(np.float32, copy=False)

    @property
    def default_steps(self) -> int:
        """Steps of refinement a frame if nobody says how many."""
        return default_steps(self.start) if self.maps.refinement is not None else 0


def read_room(
    folder: Path,
    white: float | None,
    dither: str = "ordered",
    refine: int | str | None = None,
    start: str | None = None,
) -> Room:
    """Read a calibration with its correction map; `white` None takes the level that most of the room can reach.

    refine : steps of refinement; None for the usual number where the room has the maps for it.
    start : one of STARTS, where they begin; None for what suits the room's maps.
    """
    if refine == 0 and start is not None:
        raise InputError(
            f"--refine-from {start}: --refine 0 makes no step that could start there; leave one of them out"
        )
    stored, room_maps = read_steadily(folder / calibrations.TOML, lambda: _read(folder, refinement=refine != 0))
    if (refine or start) and room_maps.refinement is None:
        raise InputError(
            f"{folder}: its maps were built without what refinement needs; "
            f"rebuild them with: counterlight build {folder}, or leave out --refine and --refine-from"
        )
    level = room_maps.white if white is None else white
    return Room(stored.calibration, room_maps, level, dither, start or default_start(room_maps.correction_in_steps))


def _read(folder: Path, *, refinement: bool) -> tuple[StoredCalibration, RoomMaps]:
    stored = calibrations.read(folder)
    return stored, maps.read_maps(stored, refinement=refinement)
