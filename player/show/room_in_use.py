"""The room that a session plays in: read again on demand, and what is asked of its calibration and kept beside it."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from counterlight import calibration
from counterlight.errors import InputError
from counterlight.media.frames import PixelFormat
from counterlight.overlay.outline import Outline, Points, lit_by, moved, outline_of, outline_on
from counterlight.pipeline.content import psnr
from counterlight.pipeline.drift import read_drift
from counterlight.pipeline.placement import Corners, corners_of, place, write_placement
from counterlight.pipeline.refinement import Certificate
from counterlight.pipeline.renderer import Renderer
from counterlight.pipeline.room import Room
from counterlight.pipeline.shortfall import Shortfall, Snapshot
from counterlight.raster import Region
from counterlight.viewpoints import Viewpoint, calibrations_in

if TYPE_CHECKING:
    from counterlight.pipeline.survey import Survey


class RoomInUse:
    """folder : its calibration.  read : reads it again.  make_renderer : for a room as read."""

    def __init__(
        self, folder: Path, room: Room, read: Callable[[], Room], make_renderer: Callable[[Room], Renderer]
    ) -> None:
        self._folder, self._room, self._read, self._make_renderer = folder, room, read, make_renderer
        self._survey: tuple[Room, Survey] | None = None
        self.stand("all")

    def stand(self, viewpoint: Viewpoint) -> str | None:
        """Take the view that is shown to viewers there; a line if one is beyond all views.

        InputError for a place in a room that was seen from one alone.
        """
        self._seen, self._viewpoint = self._room.seen_from(viewpoint), viewpoint
        return self._room.outside(viewpoint)

    def appraise(self, snapshot: Snapshot) -> Shortfall:
        """Where a drive stands; InputError without the maps of refinement. Takes seconds: for a thread of its own."""
        from counterlight.pipeline.survey import Survey  # Numba takes half a second: not before it is used

        room = self._seen
        if room.maps.refinement is None:
            raise InputError(f"{self._folder}: its maps were built without what refinement needs")
        if self._survey is None or self._survey[0] is not room:
            self._survey = room, Survey(room.maps, room.white)
        return self._survey[1].of(snapshot)

    @property
    def refinable(self) -> bool:
        """Whether the maps are there that refinement needs."""
        return all(each.maps.refinement is not None for each in self._room.eyes)

    @property
    def placed_on(self) -> tuple[int, int]:
        """(height, width) of what a picture is placed on: the camera's view, or the screen of several."""
        return self._room.calibration.placed_on

    @property
    def drifted(self) -> dict[str, Any] | None:
        """For JSON, what the last check found; None if there was none."""
        return self._room.drifted

    @property
    def drifts(self) -> bool:
        """Whether the last check has found, or no longer finds, anything to undo."""
        found = [read_drift(calibration.read(folder)) for folder in calibrations_in(self._folder)]
        return any(each is not None and each.changes for each in (*found, *(eye.drift for eye in self._room.eyes)))

    def reload(self) -> Renderer:
        """Read the maps and make a renderer of them; InputError if they do not suit the windows that are open."""
        fresh, before = self._read(), self._room.calibration.regions
        regions = fresh.calibration.regions
        if regions != before:
            raise InputError(
                f"{self._folder}: the projector's size is now {_sizes(regions)}, was {_sizes(before)}; "
                "start the player again"
            )
        renderer = self._make_renderer(fresh)
        self._room, self._survey = fresh, None
        self.stand(self._viewpoint)
        return renderer

    def fit(self, pixels: PixelFormat) -> Corners:
        """The corners of a picture that nobody placed."""
        return corners_of(place(pixels, self.placed_on), self.placed_on)

    def keep(self, corners: Corners | None) -> Path:
        """Keep corners for the next time, in the file returned."""
        return write_placement(self._folder, corners)

    def psnr(self, certificate: Certificate) -> float:
        """10 log₁₀(white² / mean (T p − b)²) over the lit camera pixels and their channels."""
        assert self._seen.maps.refinement is not None  # or there would be no certificate
        values = 3 * np.count_nonzero(self._seen.maps.refinement.lit)
        return psnr(float(certificate.squared_error.sum()) / max(int(values), 1) / self._room.white**2)

    def pointed_at(self, points: Points, view: str) -> Points:
        """Where on what a picture is placed on points of a view are; NaN where there is nothing of it.

        Of the projector's picture, what the correction map has most of.
        """
        screen = self._seen.calibration.screen
        seen = lit_by(self._seen.maps.correction, points) if view == "projector" else points
        return seen if screen is None else screen.looked_at(seen)

    def outline(self, corners: Corners, corner: int | None, view: str) -> Outline:
        """Of a picture with these corners in a view; in the projector's, where it lights the outline most."""
        screen = self._seen.calibration.screen
        drawn = outline_of(corners, corner, self.placed_on) if screen is None else outline_on(screen, corners, corner)
        return moved(drawn, partial(lit_by, self._seen.maps.transport)) if view == "projector" else drawn


def _sizes(regions: Sequence[Region]) -> str:
    return " + ".join(f"{region.width}x{region.height}" for region in regions)
