"""The room that a session plays in: reloads it, gives figures of its calibration, and stores the placement."""

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
from counterlight.pipeline.renderer import AnyRenderer
from counterlight.pipeline.room import Room
from counterlight.pipeline.shortfall import Shortfall, Snapshot
from counterlight.raster import Region
from counterlight.viewpoints import Viewpoint, calibrations_in

if TYPE_CHECKING:
    from counterlight.pipeline.survey import Survey


class RoomInUse:
    """The room of a running session.

    folder : the calibration.
    read : reads the room again.
    make_renderer : makes a renderer for a room.
    """

    def __init__(
        self, folder: Path, room: Room, read: Callable[[], Room], make_renderer: Callable[[Room], AnyRenderer]
    ) -> None:
        self._folder, self._room, self._read, self._make_renderer = folder, room, read, make_renderer
        self._survey: tuple[Room, Survey] | None = None
        self.stand("all")

    def stand(self, viewpoint: Viewpoint) -> str | None:
        """Choose the view for a viewer at `viewpoint`. Returns a warning if the viewpoint is outside all views.

        Raises InputError for a viewpoint in a room with a single view.
        """
        self._seen, self._viewpoint = self._room.seen_from(viewpoint), viewpoint
        return self._room.outside(viewpoint)

    def appraise(self, snapshot: Snapshot) -> Shortfall:
        """Estimate how far a picture is from the optimum. Takes seconds; run it in its own thread.

        Raises InputError without the maps of refinement.
        """
        from counterlight.pipeline.survey import Survey  # imported late, because Numba takes half a second

        room = self._seen
        if room.maps.refinement is None:
            raise InputError(f"{self._folder}: its maps were built without what refinement needs")
        if self._survey is None or self._survey[0] is not room:
            self._survey = room, Survey(room)
        return self._survey[1].of(snapshot)

    @property
    def read_last(self) -> Room:
        """The room as it was read last."""
        return self._room

    @property
    def refinable(self) -> bool:
        """Whether the maps for refinement exist."""
        return all(each.maps.refinement is not None for each in self._room.views)

    @property
    def placed_on(self) -> tuple[int, int]:
        """(height, width) of the area that holds the picture: the camera's view, or the screen of several cameras."""
        return self._room.calibration.placed_on

    @property
    def expected(self) -> str | None:
        """How far a captured picture may be from its prediction; None if the calibration has no interval."""
        return self._seen.expected

    @property
    def drifted(self) -> dict[str, Any] | None:
        """Result of the last check, for JSON. None without a check."""
        return self._room.drifted

    @property
    def drifts(self) -> bool:
        """Whether the last check found a drift, or the loaded room still corrects an earlier drift."""
        found = [read_drift(calibration.read(folder)) for folder in calibrations_in(self._folder)]
        return any(each is not None and each.changes for each in (*found, *(view.drift for view in self._room.views)))

    def reload(self) -> AnyRenderer:
        """Read the maps and make a renderer. Raises InputError if the projector's size has changed."""
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
        """Return the default corners of a picture."""
        return corners_of(place(pixels, self.placed_on), self.placed_on)

    def unlit(self, pixels: PixelFormat, corners: Corners | None) -> str | None:
        """Return a line about the part of a medium that gets no light, see Room."""
        return self._seen.unlit(pixels, corners)

    def keep(self, corners: Corners | None) -> Path:
        """Store corners for later shows, and return the path of the file."""
        return write_placement(self._folder, corners)

    def psnr(self, certificate: Certificate) -> float:
        """Return 10 log₁₀(white² / mean (T p − b)²) over the certified pixels and their channels, in dB."""
        values = 3 * np.count_nonzero(self._seen.certified)
        return psnr(float(certificate.squared_error.sum()) / max(int(values), 1) / self._room.white**2)

    def pointed_at(self, points: Points, view: str) -> Points:
        """Convert points of a view to points of the area that a picture is placed on. NaN for points outside it.

        For the projector's view, the correction map's largest entry decides.
        """
        screen = self._seen.calibration.screen
        seen = lit_by(self._seen.maps.correction, points) if view == "projector" else points
        return seen if screen is None else screen.looked_at(seen)

    def outline(self, corners: Corners, corner: int | None, view: str) -> Outline:
        """Return the outline of a picture with these corners in a view.

        In the projector's view, the outline is drawn where the projector lights it most.
        """
        screen = self._seen.calibration.screen
        drawn = outline_of(corners, corner, self.placed_on) if screen is None else outline_on(screen, corners, corner)
        return moved(drawn, partial(lit_by, self._seen.maps.transport)) if view == "projector" else drawn


def _sizes(regions: Sequence[Region]) -> str:
    return " + ".join(f"{region.width}x{region.height}" for region in regions)
