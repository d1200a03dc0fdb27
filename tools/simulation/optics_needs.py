"""Optical effects of materials that a scene calls for: reflective coats, clear solids, translucent bodies."""

from collections.abc import Callable

import numpy as np

from counterlight.tools.simulation.scene import Scene
from counterlight.tools.simulation.surfaces import facing_pairs

Rule = Callable[[Scene], tuple[bool, str]]


def _refraction(scene: Scene) -> tuple[bool, str]:
    for surface in scene.surfaces:
        solid = surface.material.dielectric
        if solid is not None:
            return True, f"'{surface.name}' is clear, of index {solid.index:g}"
    return False, "no solid is clear"


def _dispersion(scene: Scene) -> tuple[bool, str]:
    clear = [(surface.name, surface.material.dielectric) for surface in scene.surfaces]
    for name, solid in clear:
        if solid is not None and np.isfinite(solid.abbe) and solid.index > 1:
            return True, f"'{name}' has the Abbe number {solid.abbe:g}"
    return False, "no solid is clear" if not _refraction(scene)[0] else "all channels have one index"


def _gloss(scene: Scene) -> tuple[bool, str]:
    for surface in scene.surfaces:
        coat = surface.material.gloss
        if coat is not None:
            return True, f"'{surface.name}' reflects {100 * coat.reflectance:g} %, roughness {coat.roughness:g}"
    return False, "no surface is coated"


def _caustics(scene: Scene) -> tuple[bool, str]:
    for surface in scene.surfaces:
        if surface.material.dielectric is not None:
            return True, f"'{surface.name}' hands light on to other surfaces"
    for a, b in facing_pairs(scene.surfaces):
        for coated, other in ((a, b), (b, a)):
            if coated.material.gloss is not None:
                return True, f"'{coated.name}' reflects light onto '{other.name}'"
    return False, "no clear solid or coat hands light on to a surface"


def _subsurface(scene: Scene) -> tuple[bool, str]:
    for surface in scene.surfaces:
        if surface.material.translucency is not None:
            longest = 1000 * surface.material.translucency.mean_free_path.max()
            return True, f"light goes up to {longest:.2g} mm free in '{surface.name}'"
    return False, "no surface is translucent"


OPTICS: dict[str, Rule] = {
    "refraction": _refraction,
    "dispersion": _dispersion,
    "gloss": _gloss,
    "caustics": _caustics,
    "subsurface": _subsurface,
}
