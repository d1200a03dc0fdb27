"""A surface: a shape made of a material."""

from dataclasses import dataclass

from counterlight.tools.simulation.materials import Material
from counterlight.tools.simulation.shapes.shape import Shape


@dataclass(frozen=True, eq=False)
class Surface:
    """One of the things in a room."""

    name: str
    shape: Shape
    material: Material

    @property
    def matt(self) -> bool:
        """Does some light that meets it leave evenly to all sides?"""
        return self.material.dielectric is None
