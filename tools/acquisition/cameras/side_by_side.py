"""Several projectors' screens as one screen: the raster is cut, and each screen shows its part."""

from collections.abc import Sequence

import numpy as np

from counterlight.raster import Shape, side_by_side
from counterlight.tools.acquisition.cameras.simulated import VisibleScreen
from counterlight.tools.acquisition.plan import Codes


class SideBySide:
    """Screens that together show the raster, in order from the left."""

    def __init__(self, screens: Sequence[VisibleScreen]) -> None:
        self._screens = screens

    @property
    def shape(self) -> Shape:
        return side_by_side(self._shapes)[0]

    @property
    def refresh_hz(self) -> float | None:
        """The lowest refresh rate; None if a rate is unknown."""
        known = [screen.refresh_hz for screen in self._screens]
        return min((hz for hz in known if hz is not None), default=None) if None not in known else None

    def show(self, codes: Codes) -> None:
        for screen, region in zip(self._screens, side_by_side(self._shapes)[1], strict=True):
            screen.show(np.ascontiguousarray(codes[region.part]))

    def look(self) -> Codes:
        shape, regions = side_by_side(self._shapes)
        seen = np.zeros((*shape, 3), np.uint8)
        for screen, region in zip(self._screens, regions, strict=True):
            seen[region.part] = screen.look()
        return seen

    @property
    def _shapes(self) -> list[Shape]:
        return [screen.shape for screen in self._screens]
