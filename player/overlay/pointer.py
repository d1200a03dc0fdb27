"""What a mouse does over the picture."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Pointer:
    """x, y : in shares of the shown picture from its upper left, or beside it."""

    action: Literal["press", "move", "release"]
    x: float
    y: float
