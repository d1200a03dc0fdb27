"""The order of pictures of several projectors: black once, then a picture of each in turn, the others black."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from counterlight.raster import Shapes, side_by_side
from counterlight.tools.acquisition.few.order import BLACK, Order
from counterlight.tools.acquisition.plan import Codes, LazyPatterns


@dataclass(frozen=True)
class Turns:
    """The turns of projectors of (height, width), from the left of the raster."""

    projectors: Shapes

    @cached_property
    def orders(self) -> list[Order]:
        return [Order(projector) for projector in self.projectors]

    @property
    def least(self) -> int:
        """The least number of pictures in total that make a room."""
        return self.in_all(max(order.least for order in self.orders))

    def of_each(self, count: int) -> int:
        """Returns the pictures per projector, black included, of `count` pictures in total."""
        return 1 + (count - 1) // len(self.projectors)

    def in_all(self, of_each: int) -> int:
        return 1 + (of_each - 1) * len(self.projectors)

    def numbers(self, projector: int, of_each: int) -> list[int]:
        """Returns the capture numbers of a projector, which is numbered from 0."""
        return [BLACK, *range(1 + projector, self.in_all(of_each), len(self.projectors))]

    def pictures(self, count: int) -> Sequence[Codes]:
        """Returns the first `count` pictures of the raster."""
        return LazyPatterns(count, self._codes)

    def _codes(self, number: int) -> Codes:
        round_, projector = divmod(number - 1, len(self.projectors))
        own = self.orders[projector].codes(BLACK if number == BLACK else 1 + round_)
        if len(self.projectors) == 1:
            return own
        (height, width), regions = side_by_side(self.projectors)
        shown = np.zeros((height, width, 3), np.uint8)
        shown[regions[projector].part] = own
        return shown
