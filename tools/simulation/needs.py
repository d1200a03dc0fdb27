"""Effects that a scene calls for, with reasons, derived from geometry and numbers before any effect is imported."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from counterlight.errors import InputError, nearest
from counterlight.tools.simulation.devices import Device
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.simulation.shapes.parallelogram import Parallelogram
from counterlight.tools.simulation.surfaces import Surface, facing_pairs, outline

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


OVERLAP = 1e-3  # projector pixels²; a smaller overlap counts as none
SHARP = 1e-3  # pixels; a smaller circle of confusion moves one ray in a thousand


@dataclass(frozen=True)
class Need:
    """One effect: whether it is simulated, and the reason taken from the scene.

    worth : decibels of the final picture (study/worth.py); None if not measured.
    """

    effect: str
    on: bool
    reason: str
    worth: float | None = None


def needs_of(scene: Scene) -> dict[str, Need]:
    """Returns the need of every effect by name, in the order in which effects are applied."""
    return {name: Need(name, *rule(scene)) for name, rule in RULES.items()}


def chosen(needs: Mapping[str, Need], without: Collection[str] = (), only: Collection[str] = ()) -> dict[str, Need]:
    """Switch some effects off for a study; an effect that the scene does not call for stays off."""
    for name in (*without, *only):
        if name not in needs:
            hint = nearest(name, needs) or f"; known are {', '.join(needs)}"
            raise InputError(f"unknown effect {name!r}{hint}")
    off = dict.fromkeys(without, "--without") | {name: "--only" for name in needs if only and name not in only}
    return {
        name: replace(need, on=False, reason=f"switched off by {off[name]}") if need.on and name in off else need
        for name, need in needs.items()
    }


def _direct(scene: Scene) -> tuple[bool, str]:
    return True, "every scene has it"


def _shadows(scene: Scene) -> tuple[bool, str]:
    for a in scene.surfaces:
        if not a.shape.convex:
            return True, f"'{a.name}' is not convex: parts of it may shade others"
    for i, a in enumerate(scene.surfaces):
        for b in scene.surfaces[i + 1 :]:
            if _overlap_in_projector(scene, a, b):
                return True, f"seen from the projector, '{a.name}' and '{b.name}' overlap"
    if len(scene.surfaces) == 1:
        return False, "one surface cannot shade itself"
    return False, "seen from the projector, no surface is before another"


def _inter_reflection(scene: Scene) -> tuple[bool, str]:
    pairs = facing_pairs(scene.surfaces)
    if not pairs:
        alone = len(scene.surfaces) == 1 and scene.surfaces[0].shape.flat
        return False, "one plane" if alone else "no surface sees another"
    a, b = pairs[0]
    more = f" and {len(pairs) - 1} more pairs" if len(pairs) > 1 else ""
    if a is b:
        return True, f"parts of '{a.name}' face each other{more}"
    angle = ""
    if isinstance(a.shape, Parallelogram) and isinstance(b.shape, Parallelogram):
        angle = f" at {np.degrees(np.arccos(np.clip(-a.shape.normal @ b.shape.normal, -1, 1))):.0f}°"
    return True, f"'{a.name}' and '{b.name}' face each other{angle}{more}"


def _defocus(device: Device, scene: Scene) -> tuple[bool, str]:
    if not device.aperture:
        return False, "its lens is a pinhole"
    depths = np.concatenate([(outline(surface)[0] - device.position) @ device.forward for surface in scene.surfaces])
    ahead = depths[depths > 0]
    if not ahead.size:
        return False, "nothing is before its lens"
    widest = float(device.blur_pixels(ahead).max())
    if widest < SHARP:
        return False, f"everything is sharp: circles of confusion up to {widest:.2g} pixels"
    return True, f"from {ahead.min():.2f} to {ahead.max():.2f} m, circles of confusion up to {widest:.3g} pixels"


def _vignetting(scene: Scene) -> tuple[bool, str]:
    found = [
        f"{name}: {device.vignetting if device.vignetting == 'cos4' else f'{100 * float(device.vignetting):g} %'}"
        for name, device in (("projector", scene.projector), ("camera", scene.camera))
        if device.vignetting
    ]
    return bool(found), ", ".join(found) or "both lenses are even"


def _scattering(device: str, share: float, radius: float) -> tuple[bool, str]:
    if not share:
        return False, f"the {device}'s lens scatters no light"
    return True, f"the {device} scatters {100 * share:g} % of the light into a halo of {np.degrees(radius):g}°"


def _blooming(scene: Scene) -> tuple[bool, str]:
    return _scattering("camera", scene.camera.bloom_share, scene.camera.bloom_radius)


def _ambient_light(scene: Scene) -> tuple[bool, str]:
    if scene.ambient_irradiance.any():
        return True, f"ambient irradiance {', '.join(f'{value:g}' for value in scene.ambient_irradiance)}"
    return False, "ambient irradiance is 0"


def _black_level(scene: Scene) -> tuple[bool, str]:
    if scene.projector.black_level:
        return True, f"the projector's black is {100 * scene.projector.black_level:g} % of its white"
    return False, "the projector's black is black"


def _capture_noise(scene: Scene) -> tuple[bool, str]:
    sensor = scene.camera.sensor
    if sensor is None:
        return False, "the camera has no sensor"
    return True, f"pictures taken have {sensor.full_well:g} electrons at most and {sensor.bits} bits; T has no noise"


def _crosstalk(scene: Scene) -> tuple[bool, str]:
    mixing = scene.camera.mixing
    if mixing is None or np.array_equal(mixing, np.eye(3)):
        return False, "each channel of the camera sees its own primary alone"
    share = 1 - np.trace(mixing) / mixing.sum()
    return True, f"{100 * share:.3g} % of what the camera's channels see is of other primaries"


def _distortion(scene: Scene) -> tuple[bool, str]:
    bent = [
        f"{name}: {', '.join(f'{value:g}' for value in device.distortion)}"
        for name, device in (("projector", scene.projector), ("camera", scene.camera))
        if any(device.distortion)
    ]
    return bool(bent), "; ".join(bent) or "straight lines stay straight in both lenses"


def _colour_filters(scene: Scene) -> tuple[bool, str]:
    mosaic = scene.camera.mosaic
    if mosaic is None:
        return False, "each of the camera's pixels sees all colours"
    return True, f"a pixel sees one colour of {mosaic}, its neighbours the others"


def _flicker(scene: Scene) -> tuple[bool, str]:
    flicker = scene.projector.flicker
    if flicker is None or not flicker.depth:
        return False, "the projector's light is steady"
    return True, f"the projector's light swings by {100 * flicker.depth:g} % at {flicker.hz:g} Hz; T has none of it"


def _lateral_colour(scene: Scene) -> tuple[bool, str]:
    projector = scene.projector
    x, y, scale = np.array(projector.lateral or [(0.0, 0.0, 1.0)]).T
    apart = projector.width * np.hypot(x, y) + np.abs(scale - 1) * np.hypot(projector.width, projector.height) / 2
    if apart.max() < SHARP:
        return False, "the projector's primaries coincide"
    return True, f"the projector's primaries are up to {apart.max():.2g} pixels off the raster"


def _halo(scene: Scene) -> tuple[bool, str]:
    return _scattering("projector", scene.projector.halo_share, scene.projector.halo_radius)


def _colour_processing(scene: Scene) -> tuple[bool, str]:
    response = scene.projector.response
    if response.processing is None and response.segment is None:
        return False, "the projector's light of a primary depends on its own code alone"
    means = "a white segment" if response.processing is None else "colour processing"
    return True, f"the projector has {means}; it is in the response, and T has none of it"


def _camera_curve(scene: Scene) -> tuple[bool, str]:
    kind = scene.camera.response.kind
    if kind == "linear":
        return False, "the camera is linear"
    return True, f"pictures taken have the curve '{kind}'; T has none of it"


def _wander(scene: Scene) -> tuple[bool, str]:
    if not scene.camera.wander:
        return False, "the camera's gains are steady"
    return True, f"the gain of each picture's channel is {100 * scene.camera.wander:g} % off; T has none of it"


def _overlap_in_projector(scene: Scene, a: Surface, b: Surface) -> bool:
    outlines = []
    for surface in (a, b):
        x, y, depth = scene.projector.project(outline(surface)[0])
        if np.any(depth <= 0):
            return True  # A surface behind the projector has no polygon as its picture; the rays decide.
        outlines.append(cv2.convexHull(np.stack([x, y], axis=1).astype(np.float32)))
    area, _ = cv2.intersectConvexConvex(outlines[0], outlines[1])
    return bool(area > OVERLAP)


RULES: dict[str, Rule] = {
    "distortion": _distortion,
    "lateral_colour": _lateral_colour,
    "camera_defocus": lambda scene: _defocus(scene.camera, scene),
    "direct": _direct,
    **OPTICS,
    "projector_defocus": lambda scene: _defocus(scene.projector, scene),
    "shadows": _shadows,
    "vignetting": _vignetting,
    "inter_reflection": _inter_reflection,
    "halo": _halo,
    "ambient_light": _ambient_light,
    "black_level": _black_level,
    "blooming": _blooming,
    "crosstalk": _crosstalk,
    "colour_filters": _colour_filters,
    "colour_processing": _colour_processing,
    "flicker": _flicker,
    "wander": _wander,
    "camera_curve": _camera_curve,
    "capture_noise": _capture_noise,
}
OF_DEVICES = (
    "colour_processing",
    "flicker",
    "wander",
    "camera_curve",
    "capture_noise",
)  # effects of devices: T has none of them
TAKES = ("shadows", "vignetting")  # effects whose energy is what they remove
MOVES = (
    "distortion",
    "lateral_colour",
    "halo",
    "camera_defocus",
    "projector_defocus",
    "dispersion",
    "blooming",
    "crosstalk",
    "colour_filters",
    *OF_DEVICES,
)  # effects whose energy is what they move elsewhere
