"""Surfaces: a shape with a material; and the pairs of surfaces that face each other."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.tools.simulation.materials import Material
from counterlight.tools.simulation.shapes.parallelogram import Parallelogram
from counterlight.tools.simulation.shapes.shape import Shape, sample_places

AHEAD = 1e-9  # metres in front of a surface that count as facing it
OUTLINE_SIDE = 17  # points per axis that represent a curved surface


@dataclass(frozen=True, eq=False)
class Surface:
    """A named surface of a room."""

    name: str
    shape: Shape
    material: Material

    @property
    def matt(self) -> bool:
        """Returns whether part of the arriving light leaves diffusely."""
        return self.material.dielectric is None


def outline(surface: Surface) -> tuple[FloatArray, FloatArray]:
    """Returns points and normals (n, 3) that represent a surface: a plane's corners, or places all over it."""
    shape = surface.shape
    if isinstance(shape, Parallelogram):
        return shape.corners, np.broadcast_to(shape.normal, (4, 3))
    if getattr(shape, "grid", True) is None:  # a mesh without (u, v)
        step = max(1, len(shape.vertices) // OUTLINE_SIDE**2)  # type: ignore[attr-defined]
        faces = shape.faces[::step]  # type: ignore[attr-defined]
        return shape.vertices[faces].mean(axis=1), shape.facet_normals[::step]  # type: ignore[attr-defined]
    u, v = sample_places(shape, OUTLINE_SIDE)
    return shape.at(u, v), shape.normals(u, v)


def facing_pairs(surfaces: Sequence[Surface]) -> list[tuple[Surface, Surface]]:
    """Returns pairs of matt surfaces with points in front of each other; a non-convex surface may face itself."""
    matt = [surface for surface in surfaces if surface.matt]
    pairs = [(a, b) for i, a in enumerate(matt) for b in matt[i:] if a is not b or not a.shape.convex]
    return [(a, b) for a, b in pairs if _face(a, b)]


def _face(a: Surface, b: Surface) -> bool:
    (p, normal_p), (q, normal_q) = outline(a), outline(b)
    if a.shape.flat and b.shape.flat:
        return bool(np.any((q - p[0]) @ normal_p[0] > AHEAD) and np.any((p - q[0]) @ normal_q[0] > AHEAD))
    between = q[None] - p[:, None]
    leaves = np.sum(between * normal_p[:, None], axis=-1) > AHEAD
    arrives = -np.sum(between * normal_q[None], axis=-1) > AHEAD
    return bool(np.any(leaves & arrives))
