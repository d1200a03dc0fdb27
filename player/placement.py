"""Where a picture stands in the camera's (or the projector's) view: fitted, centred, its aspect kept."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Placement:
    """Upper left corner and size, in whole target pixels."""

    left: int
    top: int
    width: int
    height: int


def fit(shape: tuple[int, int], pixel_aspect: float, target: tuple[int, int]) -> Placement:
    """The largest placement of a picture (height, width) that keeps its aspect inside a target (height, width).

    pixel_aspect : width of one picture pixel over its height; target pixels are square.
    """
    height, width = shape[0], shape[1] * pixel_aspect
    scale = min(target[0] / height, target[1] / width)
    placed_height = min(max(1, round(height * scale)), target[0])
    placed_width = min(max(1, round(width * scale)), target[1])
    return Placement((target[1] - placed_width) // 2, (target[0] - placed_height) // 2, placed_width, placed_height)
