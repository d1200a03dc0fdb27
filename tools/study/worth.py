"""Worth of each effect of a scene in decibels of the final picture, and the effects that a tolerance calls for.

Effects are judged in a small room, on pictures shown by the best drive (box). The worth of an effect is the larger of
two errors of a T that lacks the effect. The first error is the loss when the best drive of that T is shown in the room
with the effect. The second error is how far the PSNR that this T predicts for the drive is wrong.

Both errors depend on how good a picture can get, and therefore on its smoothness from pixel to pixel. The small room
therefore shows windows of pictures of the scene's own size. A small shadow costs quality only where it falls, and a
window with the shadow does not represent the whole picture. The change in the worst window is therefore compared with
the error of all windows.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.command import track
from counterlight.errors import InputError
from counterlight.pipeline.content import psnr
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.simulation.devices import Device
from counterlight.tools.simulation.needs import OF_DEVICES, Need
from counterlight.tools.simulation.room import simulated_calibration
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.solve.box import Box
from counterlight.tools.study.pictures import find_pictures
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of

SMALL, SMALLEST = (48, 64), 24  # (height, width) into which the judged camera is fitted; shortest side of a projector
PICTURES = ("photograph", "text", "film", "dark-film")
WINDOWS = 2  # windows per picture and axis: a shadow lies on a different part of the picture in each
FEWEST_CELLS, FEWEST_SAMPLES = 400, 4  # largest numbers in the small room
MOST_BENT = 0.25  # largest slope of a lens that does not fold: three pixels in the small picture's corner
GAP, MOST_STEPS = 3e-3, 300  # relative gap of the box optimum, 0.013 dB; limit of steps for a T that lacks an effect
# no picture exists without direct light; T does not contain the others
UNJUDGED = ("direct", *OF_DEVICES)
FREE = ("ambient_light", "black_level", "vignetting", "crosstalk")  # few numbers per pixel: too fast to leave out
SPENT = 0.5  # share of a tolerance that the small room may lose


def priced(scene: Scene, needs: Mapping[str, Need], within: float | None = None) -> dict[str, Need]:
    """Returns the needs, with the worth of each active effect.

    within : a tolerance in decibels. Costly effects that together stay within half of it are switched off, least worth
        first; the other half covers what a small room does not show.
    """
    judged = [name for name, need in needs.items() if need.on and name not in UNJUDGED]
    if not judged:
        return dict(needs)
    judge = _Judge(scene, needs)
    worth = {name: judge.without([name]) for name in track(judged, "judging effects", len(judged))}
    result = {name: replace(need, worth=worth.get(name)) for name, need in needs.items()}
    if within is not None:
        costly = sorted((name for name in judged if name not in FREE), key=lambda name: worth[name])
        for name in _affordable(judge, costly, worth, SPENT * within):
            reason = f"not worth its price (--within {within:g} dB): {needs[name].reason}"
            result[name] = replace(result[name], on=False, reason=reason)
    return result


def _affordable(judge: "_Judge", costly: Sequence[str], worth: Mapping[str, float], most: float) -> list[str]:
    """Returns effects that together are worth at most `most` decibels."""
    off: list[str] = []
    for name in costly:
        if worth[name] > most:
            break
        if not off or judge.without([*off, name]) <= most:
            off.append(name)
    return off


def small_room(scene: Scene) -> Scene:
    """Returns the scene at a size at which judging takes seconds; lengths in pixels stay the same.

    Circles of confusion, halos, scattering lengths and dispersion grow with the pixels, and lenses bend the picture by
    the same number of pixels.
    """
    camera, projector = scene.camera, scene.projector
    wanted = max(camera.height / SMALL[0], camera.width / SMALL[1])
    scale = max(1.0, min(wanted, projector.height / SMALLEST, projector.width / SMALLEST))
    sizes = ((max(1, round(each.height / scale)), max(1, round(each.width / scale))) for each in (camera, projector))
    small = scene.resized(*sizes)
    return replace(
        small,
        camera=replace(
            small.camera,
            aperture=scale * camera.aperture,
            distortion=_bent(camera, scale),
            bloom_radius=_wider(camera.bloom_radius, scale),
        ),
        projector=replace(
            small.projector,
            aperture=scale * projector.aperture,
            distortion=_bent(projector, scale),
            halo_radius=_wider(projector.halo_radius, scale),
            lateral=tuple((scale * x, scale * y, 1 + scale * (z - 1)) for x, y, z in projector.lateral),
        ),
        surfaces=tuple(replace(each, material=each.material.enlarged(scale)) for each in scene.surfaces),
        samples=min(scene.samples, FEWEST_SAMPLES),
        cells=min(scene.cells, FEWEST_CELLS),
    )


def _wider(angle: float, scale: float) -> float:
    return float(np.arctan(scale * np.tan(angle)))


def _bent(device: Device, scale: float) -> tuple[float, ...]:
    """Returns coefficients of a lens that bends up to `scale` times as far, and never less than the given lens.

    In the picture's corner the small lens' slope stays below MOST_BENT, so that no picture folds over.
    """
    k1, k2, p1, p2, k3 = np.abs(device.distortion)
    square = device.tan_half[0] ** 2 + device.tan_half[1] ** 2
    slope = square * (3 * k1 + square * (5 * k2 + square * 7 * k3)) + 6 * np.sqrt(square) * (p1 + p2)
    most = max(1.0, min(scale, MOST_BENT / slope)) if slope else 1.0
    return tuple(most * each for each in device.distortion)


class _Judge:
    """The small room with all its effects, and windows of pictures with their best drives."""

    def __init__(self, scene: Scene, needs: Mapping[str, Need]) -> None:
        self._scene, self._needs = small_room(scene), needs
        self._whole = _Room(self._scene, needs)
        own, small = ((each.camera.height, each.camera.width) for each in (scene, self._scene))
        white, pictures = self._whole.tier.white, find_pictures(PICTURES)
        self._asked = [[white * each for each in _windows(picture.at(own), small)] for picture in pictures]
        self._best = [self._errors(self._whole, self._drives(self._whole, asked), asked) for asked in self._asked]

    def without(self, effects: Collection[str]) -> float:
        """Returns the error of a room without some effects, dB of the worst picture; infinite if it shows nothing."""
        try:
            lacking = _Room(self._scene, self._needs, effects)
        except InputError:  # no light is left
            return float("inf")
        return max(self._off(lacking, asked, best) for asked, best in zip(self._asked, self._best, strict=True))

    def _off(self, lacking: "_Room", asked: Sequence[FloatArray], best: FloatArray) -> float:
        drives = self._drives(lacking, asked)
        shown, promised = (self._errors(room, drives, asked) for room in (self._whole, lacking))
        return max(
            _lost(best, shown),
            abs(_lost(best, promised)),
            *(_lost(best, best + np.abs(each - best).max()) for each in (shown, promised)),
        )

    def _drives(self, room: "_Room", asked: Sequence[FloatArray]) -> list[FloatArray]:
        return [room.drive(each) for each in asked]

    def _errors(self, room: "_Room", drives: Sequence[FloatArray], asked: Sequence[FloatArray]) -> FloatArray:
        """Returns the mean squared errors (windows,) of drives in a room, inside the mask of the whole room."""
        mask, white = self._whole.tier.calibration.mask, self._whole.tier.white
        errors = [(room.tier.seen(p) - each)[mask] / white for p, each in zip(drives, asked, strict=True)]
        return np.array([np.mean(np.square(each)) for each in errors])


def _lost(best: FloatArray, errors: FloatArray) -> float:
    """Returns the decibels between the mean squares of two sets of windows."""
    return psnr(float(np.mean(best))) - psnr(float(np.mean(errors)))


def _windows(picture: FloatArray, shape: tuple[int, int]) -> list[FloatArray]:
    """Returns parts of a picture with a shape (height, width), spread over it; the whole if it is no larger."""
    count = 1 if picture.shape[:2] == shape else WINDOWS
    tops, lefts = (
        [round(share * (whole - part)) for share in (np.arange(count) + 0.5) / count]
        for whole, part in zip(picture.shape, shape, strict=False)
    )
    return [picture[top : top + shape[0], left : left + shape[1]] for top in tops for left in lefts]


class _Room:
    """A simulated scene without some effects, and the best drives by its own T."""

    def __init__(self, scene: Scene, needs: Mapping[str, Need], without: Collection[str] = ()) -> None:
        result = simulate(scene, needs, without=without)
        self.tier = tier_of(simulated_calibration(scene, result), result.transport)
        objective = objective_of(self.tier.transport, self.tier.calibration, DEFAULT_AIMS, self.tier.mixing)
        self._box = Box(objective.unweighted, tolerance=GAP, most_steps=MOST_STEPS)

    def drive(self, asked: FloatArray) -> FloatArray:
        """Returns the drive (projector pixels, 3) for a picture in screen primaries.

        asked : (camera height, camera width, 3).
        """
        return self._box.solve(self.tier.target(asked).reshape(-1, 3)).drive
