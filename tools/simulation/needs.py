"""Which effects a scene calls for, and why: read off its geometry and its numbers, before any effect is imported."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from tools.simulation.geometry import project
from tools.simulation.scene import Scene, Surface

COPLANAR = 1e-9  # metres
OVERLAP = 1e-3  # projector pixels²


@dataclass(frozen=True)
class Need:
    """One effect: is it simulated, and the reason taken from the scene."""

    effect: str
    on: bool
    reason: str


def needs_of(scene: Scene) -> dict[str, Need]:
    """Every effect that can be simulated, by name, in the order of their work."""
    rules: dict[str, Callable[[Scene], tuple[bool, str]]] = {
        "direct": lambda _: (True, "every scene has it"),
        "shadows": _shadows,
        "inter_reflection": _inter_reflection,
        "ambient_light": _ambient_light,
        "black_level": _black_level,
    }
    return {name: Need(name, *rule(scene)) for name, rule in rules.items()}


def facing_pairs(scene: Scene) -> list[tuple[Surface, Surface]]:
    """Pairs of surfaces of which each has a part in front of the other."""
    surfaces = scene.surfaces
    pairs = [(a, b) for i, a in enumerate(surfaces) for b in surfaces[i + 1 :]]
    return [(a, b) for a, b in pairs if _in_front(a, b) and _in_front(b, a)]


def _shadows(scene: Scene) -> tuple[bool, str]:
    for i, a in enumerate(scene.surfaces):
        for b in scene.surfaces[i + 1 :]:
            if _overlap_in_projector(scene, a, b):
                return True, f"seen from the projector, '{a.name}' and '{b.name}' overlap"
    if len(scene.surfaces) == 1:
        return False, "one surface cannot shade itself"
    return False, "seen from the projector, no surface is before another"


def _inter_reflection(scene: Scene) -> tuple[bool, str]:
    pairs = facing_pairs(scene)
    if not pairs:
        only = "one plane" if len(scene.surfaces) == 1 else "no surface sees another"
        return False, only
    a, b = pairs[0]
    angle = np.degrees(np.arccos(np.clip(-a.normal @ b.normal, -1, 1)))
    more = f" and {len(pairs) - 1} more pairs" if len(pairs) > 1 else ""
    return True, f"'{a.name}' and '{b.name}' face each other at {angle:.0f}°{more}"


def _ambient_light(scene: Scene) -> tuple[bool, str]:
    if scene.ambient_irradiance.any():
        return True, f"ambient irradiance {', '.join(f'{value:g}' for value in scene.ambient_irradiance)}"
    return False, "ambient irradiance is 0"


def _black_level(scene: Scene) -> tuple[bool, str]:
    if scene.black_level:
        return True, f"the projector's black is {100 * scene.black_level:g} % of its white"
    return False, "the projector's black is black"


def _in_front(a: Surface, b: Surface) -> bool:
    """Is any corner of b in front of a's plane?"""
    return bool(np.any((b.corners - a.corner) @ a.normal > COPLANAR))


def _overlap_in_projector(scene: Scene, a: Surface, b: Surface) -> bool:
    outlines = []
    for surface in (a, b):
        x, y, depth = project(scene.projector, surface.corners)
        if np.any(depth <= 0):
            return True  # reaches behind the projector: its picture is no polygon, so let the rays decide
        outlines.append(np.stack([x, y], axis=1).astype(np.float32))
    area, _ = cv2.intersectConvexConvex(outlines[0], outlines[1])
    return bool(area > OVERLAP)
