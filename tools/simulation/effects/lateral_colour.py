"""Lateral colour: each primary's picture is scaled about the raster's middle and shifted, as lenses and panels do.

Light of pixel x lands where light of an exact projector's pixel (x − m) z + m + d would, with the scale z, the shift d
and the middle m. Each pixel keeps its flux. The projector side of light paths is traced once per primary.
"""

from dataclasses import fields, replace

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.devices import Projector
from counterlight.tools.simulation.scene import Scene


class _Primary(Projector):
    """The projector of one primary.

    place : shift right and down in pixels, and scale.
    """

    place: tuple[float, float, float]

    def picture_of(self, across: FloatArray, up: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y = super().picture_of(across, up)
        right, down, scale = self.place
        return _scaled(x - right, self.width, 1 / scale), _scaled(y - down, self.height, 1 / scale)

    def direction_of(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        right, down, scale = self.place
        return super().direction_of(_scaled(x, self.width, scale) + right, _scaled(y, self.height, scale) + down)

    def crowding(self, across: FloatArray, up: FloatArray) -> FloatArray | float:
        return super().crowding(across, up) / self.place[2] ** 2


def primaries(scene: Scene) -> list[tuple[Scene, FloatArray]]:
    """Returns per primary the scene with its projector, and 1 for its own channel, 0 for the others: (3,)."""
    projector = scene.projector
    given = {field.name: getattr(projector, field.name) for field in fields(projector)}
    found = []
    for (x, y, scale), own in zip(projector.lateral, np.eye(3), strict=True):
        place = projector.width * x, projector.width * y, scale
        kind = type("_Primary", (_Primary, type(projector)), {"place": place})
        found.append((replace(scene, projector=kind(**given)), own))
    return found


def _scaled(at: FloatArray, size: int, scale: float) -> FloatArray:
    return (at - size / 2) * scale + size / 2
