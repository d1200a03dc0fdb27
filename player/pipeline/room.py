"""A room as it is played in: its calibration, its maps, and how they are used."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight import calibration as calibrations
from counterlight.arrays import brief
from counterlight.calibration import Calibration
from counterlight.errors import InputError, nearest
from counterlight.files.generation import read_steadily
from counterlight.maps import room_maps as maps
from counterlight.maps.mixing import Mixing
from counterlight.maps.room_maps import RoomMaps
from counterlight.pipeline.drift import Drift, read_drift
from counterlight.pipeline.refinement import STARTS, Advice, Offer, advice_of, default_steps
from counterlight.pipeline.views_together import check_views, with_shared_darkness
from counterlight.viewpoints import Places, Viewpoint, folders_of, is_set, read_places

DITHERS = ("ordered", "noise", "none")


@dataclass(frozen=True)
class Room:
    """What a renderer needs to know of a room.

    white : camera radiance of a white picture, in each channel.  dither : one of DITHERS.
    start : one of counterlight.pipeline.refinement.STARTS, where refinement begins.
    drift : what has changed since the calibration, whose ambient light is that of now; None if nobody has looked.
    others, places : of a set of views the further ones, and where all stand; this is the first.
    """

    calibration: Calibration
    maps: RoomMaps
    white: float
    dither: str = "ordered"
    start: str = "previous"
    drift: Drift | None = None
    others: tuple["Room", ...] = ()
    places: Places | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        for name, value, known in (("dither", self.dither, DITHERS), ("start", self.start, STARTS)):
            if value not in known:
                raise InputError(f"{name} {value!r}: expected one of {', '.join(known)}{nearest(str(value), known)}")

    @property
    def eyes(self) -> tuple["Room", ...]:
        """The room as it is seen from each of its views."""
        return (self, *self.others)

    def shares(self, viewpoint: Viewpoint) -> NDArray[np.float64]:
        """Of each eye, for viewers there; InputError for a place in a room that was seen from one alone."""
        if self.places is not None:
            return self.places.shares(viewpoint)
        if viewpoint != "all":
            raise InputError(
                "a viewpoint is for a room of several views, this one has one; join views with: "
                "counterlight join VIEW… --at X[,Y]… -o FOLDER"
            )
        return np.ones(1)

    @property
    def drifted(self) -> dict[str, Any] | None:
        """For JSON, what the last check found; None if there was none."""
        return None if self.drift is None else self.drift.to_dict(self.calibration.projectors)

    def seen_from(self, viewpoint: Viewpoint) -> "Room":
        """The eye that has the largest share, whose view is shown."""
        return self.eyes[int(self.shares(viewpoint).argmax())]

    def outside(self, viewpoint: Viewpoint) -> str | None:
        """A line about viewers who stand beyond all views, None if nobody does."""
        return None if self.places is None else self.places.outside(viewpoint)

    @cached_property
    def mixing(self) -> Mixing:
        """Of the maps, as far as they still have all light of a camera pixel (Drift.share)."""
        share = None if self.drift is None else self.drift.share
        return self.maps.mixing if share is None else self.maps.mixing.shared(share)

    @cached_property
    def ambient(self) -> NDArray[np.float32]:
        """Q e: light without the projector, in screen primaries, (camera height, camera width, 3)."""
        return self.mixing.on_screen(self.calibration.ambient).astype(np.float32, copy=False)

    @property
    def default_steps(self) -> int:
        """Steps of refinement a frame if nobody says how many; of several views what the neediest needs."""
        if self.others:
            return max(replace(each, others=(), start=self.start).default_steps for each in self.eyes)
        if self.maps.refinement is None:
            return 0
        advice = _advice(self.maps)
        return advice.steps if advice is not None and advice.start == self.start else default_steps(self.start)

    @property
    def offers(self) -> tuple[Offer, ...]:
        """The starts that the build has measured, and what they cost in steps; none without refinement."""
        advice, refinement = _advice(self.maps), self.maps.refinement
        if advice is None or refinement is None:
            return ()
        costs = {"previous": self.maps.correction_in_steps, "previous-direct": self.maps.direct_in_steps}
        return tuple(Offer(name, costs[name], curve) for name, curve in advice.curves.items() if name in costs)


def read_room(
    folder: Path,
    white: float | None,
    dither: str = "ordered",
    refine: int | str | None = None,
    start: str | None = None,
    *,
    words: bool = False,
) -> Room:
    """Read a calibration with its correction map; `white` None takes the level that most of the room can reach.

    refine : steps of refinement; None for the usual number where the room has the maps for it.
    start : one of STARTS, where they begin; None for what suits the room's maps.
    words : read the maps in words, too, if the room has any.
    Of a set of views all are read, for one white, one start, and no view's darkness where another one sees light.
    """
    if is_set(folder):
        return _read_set(folder, white, dither, refine, start, words=words)
    if refine == 0 and start is not None:
        raise InputError(
            f"--refine-from {start}: --refine 0 makes no step that could start there; leave one of them out"
        )
    calibration, room_maps, drift = read_steadily(
        folder / calibrations.TOML, lambda: _read(folder, refinement=refine != 0, words=words)
    )
    if (refine or start) and room_maps.refinement is None:
        raise InputError(
            f"{folder}: its maps were built without what refinement needs; rebuild them with: "
            f"counterlight build {folder}, or leave out --refine, --refine-from, --budget and --within"
        )
    reachable = room_maps.white * (1.0 if drift is None else drift.dimming)
    level = reachable if white is None else white
    return Room(calibration, room_maps, level, dither, start or start_of(room_maps, folder), drift)


def _read_set(folder: Path, white: float | None, *told: Any, words: bool) -> Room:
    places = read_places(folder, calibrations.TOML)
    rooms = [read_room(view, white, *told, words=words) for view in folders_of(folder, len(places.at))]
    check_views([each.calibration for each in rooms], f"{folder}")
    level = min(each.white for each in rooms)
    if all(each.maps.refinement is not None for each in rooms):
        maps_of = with_shared_darkness([each.maps for each in rooms])
        rooms = [replace(each, maps=maps) for each, maps in zip(rooms, maps_of, strict=True)]
    first, *others = (replace(each, white=level, start=rooms[0].start) for each in rooms)
    return replace(first, others=tuple(others), places=places)


def start_of(room_maps: RoomMaps, folder: Path | None = None) -> str:
    """Where refinement starts if nobody says: as the maps advise, else from T⁺."""
    advice = _advice(room_maps, folder)
    return STARTS[0] if advice is None else advice.start


def _advice(room_maps: RoomMaps, folder: Path | None = None) -> Advice | None:
    where = "maps" if folder is None else f"{folder / maps.FOLDER / maps.MANIFEST}"
    fix = "" if folder is None else f"rebuild it with: counterlight build {folder}"
    return advice_of(room_maps.details, where, fix)


def _read(folder: Path, *, refinement: bool, words: bool) -> tuple[Calibration, RoomMaps, Drift | None]:
    """The calibration's ambient light is that of now."""
    stored = calibrations.read(folder)
    drift = read_drift(stored)
    calibration = stored.calibration
    if drift is not None and drift.ambient is not None:
        calibration = replace(calibration, ambient=drift.ambient)
    return calibration, maps.read_maps(stored, refinement=refinement, words=words), drift
