"""A room for playback: its calibration, its maps, and how they are used."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from counterlight import calibration as calibrations
from counterlight.arrays import BoolArray, brief
from counterlight.calibration import RADIANCE, Calibration
from counterlight.errors import InputError, nearest
from counterlight.files.manifest import read_steadily
from counterlight.files.tables import Table
from counterlight.maps import room_maps as maps
from counterlight.maps.mixing import Mixing
from counterlight.maps.room_maps import RoomMaps
from counterlight.media.frames import PixelFormat
from counterlight.pipeline.drift import Drift, read_drift
from counterlight.pipeline.placement import Corners, corners_of, place, share_outside
from counterlight.pipeline.refinement import STARTS, Advice, Offer, advice_of, default_steps
from counterlight.pipeline.views_together import check_views, with_shared_darkness
from counterlight.viewpoints import Places, Viewpoint, folders_of, is_set, read_places

LEAST_UNLIT = 0.05  # least share of a picture without light that is reported
DITHERS = ("ordered", "noise", "none")


@dataclass(frozen=True)
class Room:
    """The inputs of a renderer.

    white : camera radiance of a white picture, the same in each channel.
    dither : one of DITHERS.
    start : where refinement starts; one of counterlight.pipeline.refinement.STARTS.
    drift : changes since the calibration, if checked; None otherwise. `calibration` then holds the current ambient
        light.
    within : radiance within which 9 of 10 values of a typical camera pixel arrive, in black and in white; None if the
        calibration has no interval.
    others : the further views of a set; this room is the first view.
    places : positions of all views of a set.
    """

    calibration: Calibration
    maps: RoomMaps
    white: float
    dither: str = "ordered"
    start: str = "previous"
    drift: Drift | None = None
    within: tuple[float, float] | None = None
    others: tuple["Room", ...] = ()
    places: Places | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        for name, value, known in (("dither", self.dither, DITHERS), ("start", self.start, STARTS)):
            if value not in known:
                raise InputError(f"{name} {value!r}: expected one of {', '.join(known)}{nearest(str(value), known)}")

    @property
    def views(self) -> tuple["Room", ...]:
        """The room as seen from each of its views."""
        return (self, *self.others)

    def shares(self, viewpoint: Viewpoint) -> NDArray[np.float64]:
        """Return each view's share for viewers at a place; raises InputError for a place in a room with one view."""
        if self.places is not None:
            return self.places.shares(viewpoint)
        if viewpoint != "all":
            raise InputError(
                "a viewpoint is for a room of several views, this one has one; join views with: "
                "counterlight join VIEW… --at X[,Y]… -o FOLDER"
            )
        return np.ones(1)

    @property
    def expected(self) -> str | None:
        """How far a captured picture may be from its prediction; None if the calibration has no interval."""
        if self.within is None:
            return None
        black, white = (100 * each / self.white for each in self.within)
        return f"9 of 10 pixels arrive within {black:.2g} % (black) to {white:.2g} % (white) of white"

    @property
    def drifted(self) -> dict[str, Any] | None:
        """Result of the last check, for JSON; None without a check."""
        return None if self.drift is None else self.drift.to_dict(self.calibration.projectors)

    def seen_from(self, viewpoint: Viewpoint) -> "Room":
        """Return the view with the largest share, which is shown."""
        return self.views[int(self.shares(viewpoint).argmax())]

    def outside(self, viewpoint: Viewpoint) -> str | None:
        """Return a line about viewers beyond all views; None if there are none."""
        return None if self.places is None else self.places.outside(viewpoint)

    def unlit(self, pixels: PixelFormat, corners: Corners | None) -> str | None:
        """Return a line about the part of a medium that gets no light; None if small, or with several cameras.

        corners : of the picture in the view; None fits it.
        """
        shape = self.calibration.camera.shape
        if self.calibration.screen is not None:
            return None
        share = share_outside(corners or corners_of(place(pixels, shape), shape), self.lit & self.calibration.mask)
        if share <= LEAST_UNLIT:
            return None
        return f"{100 * share:.0f} % of the picture lies beyond the projector's light; key k places it (docs/player.md)"

    @property
    def lit(self) -> BoolArray:
        """The camera pixels to which figures refer, (camera height, camera width); the mask in rooms built before."""
        return self.calibration.mask if self.maps.lit is None else self.maps.lit

    @property
    def certified(self) -> BoolArray:
        """The lit pixels that refinement weighs, for which its certificate holds, (camera height, camera width)."""
        assert self.maps.refinement is not None
        return self.lit & (self.maps.refinement.weights > 0)

    @cached_property
    def mixing(self) -> Mixing:
        """The maps' mixing, reduced where part of a camera pixel's light is from beyond the raster (`Drift.share`)."""
        share = None if self.drift is None else self.drift.share
        return self.maps.mixing if share is None else self.maps.mixing.shared(share)

    @cached_property
    def ambient(self) -> NDArray[np.float32]:
        """Q e: light without the projector, in screen primaries, (camera height, camera width, 3)."""
        return self.mixing.on_screen(self.calibration.ambient).astype(np.float32, copy=False)

    @property
    def default_steps(self) -> int:
        """The default steps of refinement per frame; for several views, the largest number of all."""
        if self.others:
            return max(replace(each, others=(), start=self.start).default_steps for each in self.views)
        if self.maps.refinement is None:
            return 0
        advice = _advice(self.maps)
        return advice.steps if advice is not None and advice.start == self.start else default_steps(self.start)

    @property
    def offers(self) -> tuple[Offer, ...]:
        """The starts that the build has measured, with their cost in steps; empty without refinement."""
        advice, refinement = _advice(self.maps), self.maps.refinement
        if advice is None or refinement is None:
            return ()
        costs = {"previous": self.maps.correction_in_steps, "previous-direct": self.maps.direct_in_steps}
        return tuple(Offer(name, costs[name], curve) for name, curve in advice.curves.items() if name in costs)


def read_room(
    folder: Path,
    white: float | None,
    dither: str = "ordered",
    start: str | None = None,
    *,
    refinement: bool = True,
    words: bool = False,
) -> Room:
    """Read a calibration with its correction map.

    white : radiance of white; None takes the level that most of the room can reach.
    start : one of STARTS; None for the start that suits the room's maps.
    refinement : whether to read the maps of refinement as well, if the room has them.
    words : whether to read the maps packed in words as well, if the room has them.

    A set of views is read as a whole, with one white and one start. No view's prior then darkens projector pixels that
    another view sees.
    """
    if is_set(folder):
        return _read_set(folder, white, dither, start, refinement=refinement, words=words)
    calibration, room_maps, drift = read_steadily(
        folder / calibrations.TOML, lambda: _read(folder, refinement=refinement, words=words)
    )
    reachable = room_maps.white * (1.0 if drift is None else drift.dimming)
    level = reachable if white is None else white
    return Room(
        calibration, room_maps, level, dither, start or start_of(room_maps, folder), drift, _within(room_maps, folder)
    )


def _read_set(folder: Path, white: float | None, *options: Any, refinement: bool, words: bool) -> Room:
    places = read_places(folder, calibrations.TOML)
    views = folders_of(folder, len(places.at))
    rooms = [read_room(view, white, *options, refinement=refinement, words=words) for view in views]
    check_views([each.calibration for each in rooms], f"{folder}")
    level = min(each.white for each in rooms)
    if all(each.maps.refinement is not None for each in rooms):
        maps_of = with_shared_darkness([each.maps for each in rooms])
        rooms = [replace(each, maps=maps) for each, maps in zip(rooms, maps_of, strict=True)]
    first, *others = (replace(each, white=level, start=rooms[0].start) for each in rooms)
    return replace(first, others=tuple(others), places=places)


def start_of(room_maps: RoomMaps, folder: Path | None = None) -> str:
    """Return the default start of refinement: the advice of the maps, else T⁺."""
    advice = _advice(room_maps, folder)
    return STARTS[0] if advice is None else advice.start


def _advice(room_maps: RoomMaps, folder: Path | None = None) -> Advice | None:
    return advice_of(room_maps.details, *_place(folder))


def _within(room_maps: RoomMaps, folder: Path) -> tuple[float, float] | None:
    table = Table(room_maps.details, *_place(folder)).table("interval", optional=True)
    if not table.values:
        return None
    return table.number("black", None, 0, RADIANCE[1]), table.number("white", None, 0, RADIANCE[1])


def _place(folder: Path | None) -> tuple[str, str]:
    """Return the maps' name for messages, and the remedy."""
    if folder is None:
        return "maps", ""
    return f"{folder / maps.FOLDER / maps.MANIFEST}", f"rebuild it with: counterlight build {folder}"


def _read(folder: Path, *, refinement: bool, words: bool) -> tuple[Calibration, RoomMaps, Drift | None]:
    """Read calibration, maps and drift; a drift's ambient light replaces the calibration's."""
    stored = calibrations.read(folder)
    drift = read_drift(stored)
    calibration = stored.calibration
    if drift is not None and drift.ambient is not None:
        calibration = replace(calibration, ambient=drift.ambient)
    return calibration, maps.read_maps(stored, refinement=refinement, words=words), drift
