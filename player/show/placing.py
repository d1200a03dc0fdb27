"""Places the picture in the camera's view by hand: move, scale, drag a corner, undo."""

from dataclasses import dataclass, field

from counterlight.errors import InputError
from counterlight.pipeline.placement import Corners, check_corners

REACH = 0.04  # distance from a corner, in views, within which the mouse grabs the corner
CORNER_NAMES = ("upper left", "upper right", "lower right", "lower left")


@dataclass
class Placing:
    """The state of placing.

    corners : the present corners.
    before : the corners at the beginning.
    corner : index of the selected corner; None for the whole picture.
    """

    corners: Corners
    before: Corners | None
    corner: int | None = None
    _history: list[Corners] = field(default_factory=list)
    _held: tuple[float, float] | None = None

    def move(self, dx: float, dy: float) -> None:
        """Move the selected corner, or the whole picture, by shares of the view."""
        self._put(self._moved(dx, dy))

    def grab(self, x: float, y: float) -> None:
        """Grab the corner near (x, y), or else the whole picture."""
        away = [max(abs(x - corner_x), abs(y - corner_y)) for corner_x, corner_y in self.corners]
        self.corner = away.index(min(away)) if min(away) <= REACH else None
        self._held = x, y
        self._history.append(self.corners)

    def drag(self, x: float, y: float) -> bool:
        """Move the grabbed part to (x, y). Returns False if nothing is grabbed or the picture would become invalid."""
        if self._held is None:
            return False
        a, b, c, d = self._moved(x - self._held[0], y - self._held[1])
        try:
            check_corners((a, b, c, d))
        except InputError:
            return False
        self.corners, self._held = (a, b, c, d), (x, y)
        return True

    def let_go(self) -> None:
        if self._held is not None and self._history[-1] == self.corners:
            self._history.pop()
        self._held = None

    def scale(self, factor: float) -> None:
        """Scale the picture about its middle."""
        middle_x, middle_y = (sum(axis) / 4 for axis in zip(*self.corners, strict=True))
        self._put([(middle_x + factor * (x - middle_x), middle_y + factor * (y - middle_y)) for x, y in self.corners])

    def put(self, corners: Corners) -> None:
        self._put(list(corners))

    def refit(self, corners: Corners) -> None:
        """Start from the corners of another medium. Clears the history and keeps a grab."""
        self.corners = corners
        self._history = [] if self._held is None else [corners]

    def undo(self) -> bool:
        """Undo the last change. Returns False if there is none."""
        if not self._history:
            return False
        self.corners = self._history.pop()
        return True

    def select_next(self) -> None:
        """Select the next part: the whole picture, then each corner clockwise from the upper left."""
        following = 0 if self.corner is None else self.corner + 1
        self.corner = following if following < len(CORNER_NAMES) else None

    @property
    def selected(self) -> str:
        return "whole picture" if self.corner is None else f"{CORNER_NAMES[self.corner]} corner"

    def _moved(self, dx: float, dy: float) -> list[tuple[float, float]]:
        """Return the corners with the selected corner, or all corners, moved."""
        return [
            (x + dx, y + dy) if self.corner in (None, index) else (x, y) for index, (x, y) in enumerate(self.corners)
        ]

    def _put(self, points: list[tuple[float, float]]) -> None:
        a, b, c, d = points
        check_corners((a, b, c, d))
        self._history.append(self.corners)
        self.corners = (a, b, c, d)
