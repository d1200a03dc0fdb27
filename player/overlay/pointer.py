"""Mouse events over the picture."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Pointer:
    """A mouse event at (x, y), in shares of the shown picture from its upper left. It may lie outside the picture."""

    action: Literal["press", "move", "release"]
    x: float
    y: float
