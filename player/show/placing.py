"""Placing the picture in the camera's view by hand: move, scale, pull a corner, undo."""

from dataclasses import dataclass, field

from counterlight.pipeline.placement import Corners, check_corners

CORNER_NAMES = ("upper left", "upper right", "lower right", "lower left")


@dataclass
class Placing:
    """corners : now.  before : when it began.  corner : the index of the selected one; None for the whole picture."""

    corners: Corners
    before: Corners | None
    corner: int | None = None
    _history: list[Corners] = field(default_factory=list)

    def move(self, dx: float, dy: float) -> None:
        """Move the selected corner, or the whole picture, by shares of the view."""
        moved = [
            (x + dx, y + dy) if self.corner in (None, index) else (x, y) for index, (x, y) in enumerate(self.corners)
        ]
        self._put(moved)

    def scale(self, factor: float) -> None:
        """Scale the picture about its middle."""
        middle_x, middle_y = (sum(axis) / 4 for axis in zip(*self.corners, strict=True))
        self._put([(middle_x + factor * (x - middle_x), middle_y + factor * (y - middle_y)) for x, y in self.corners])

    def put(self, corners: Corners) -> None:
        self._put(list(corners))

    def undo(self) -> bool:
        """Take the last change back; False if there is none."""
        if not self._history:
            return False
        self.corners = self._history.pop()
        return True

    def select_next(self) -> None:
        """The whole picture, then each corner clockwise from the upper left."""
        following = 0 if self.corner is None else self.corner + 1
        self.corner = following if following < len(CORNER_NAMES) else None

    @property
    def selected(self) -> str:
        return "whole picture" if self.corner is None else f"{CORNER_NAMES[self.corner]} corner"

    def _put(self, points: list[tuple[float, float]]) -> None:
        a, b, c, d = points
        check_corners((a, b, c, d))
        self._history.append(self.corners)
        self.corners = (a, b, c, d)
