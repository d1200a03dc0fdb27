"""What each effect of a scene is worth in decibels of the final picture, and which of them a tolerance calls for.

Judged in a small room, on pictures as the best drive (box) shows them. An effect is worth the larger of two errors of a
T that lacks it: what is lost where its best drive is shown in the room that has the effect, and by how much the
PSNR that such a T predicts for that drive is off. Both depend on how good a picture can get, and that on how smooth it
is from pixel to pixel: so the small room shows windows of pictures of the scene's own size. A small shadow costs what
is shown where it falls, and no window shows there what the whole picture does: what an effect changes in the worst
window counts, against the error of all of them.
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
from counterlight.tools.simulation.needs import Need
from counterlight.tools.simulation.room import simulated_calibration
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.solve.box import Box
from counterlight.tools.study.pictures import find_pictures
from counterlight.tools.transport.objective import DEFAULT_AIMS, objective_of

SMALL, SMALLEST = (48, 64), 24  # (height, width) that the judged camera is fitted into; a projector's side
PICTURES = ("photograph", "text", "film", "dark-film")
WINDOWS = 2  # of a picture, along and across: a shadow is on a different part of it in each
FEWEST_CELLS, FEWEST_SAMPLES = 400, 4  # of the small room, if the scene has more
MOST_BENT = 0.25  # of a lens that does not fold: three pixels in the small picture's corner
GAP, MOST_STEPS = 3e-3, 300  # of the box optimum: 0.013 dB, unless a T that lacks something takes too long
UNJUDGED = ("direct", "flicker", "capture_noise")  # no picture is without the first; T has nothing of the others
FREE = ("ambient_light", "black_level", "vignetting", "crosstalk")  # a few numbers a pixel: nothing to save
SPENT = 0.5  # of a tolerance, in the small room


def priced(scene: Scene, needs: Mapping[str, Need], within: float | None = None) -> dict[str, Need]:
    """The needs, each effect that is on with what it is worth.

    within : a tolerance in decibels; what costs time and stays within half of it, all together, is switched
    off, least worth first. The rest is for what a small room does not show.
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
    """Effects that together are worth at most so many decibels."""
    off: list[str] = []
    for name in costly:
        if worth[name] > most:
            break
        if not off or judge.without([*off, name]) <= most:
            off.append(name)
    return off


def _small(scene: Scene) -> Scene:
    """The scene at a size at which judging takes seconds; what is told in pixels stays as many.

    Circles of confusion, halos, the way of light in a body and between the colours of a prism grow with the pixels, and
    lenses bend the picture by as many.
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
            bloom_radius=float(np.arctan(scale * np.tan(camera.bloom_radius))),
        ),
        projector=replace(small.projector, aperture=scale * projector.aperture, distortion=_bent(projector, scale)),
        surfaces=tuple(replace(each, material=each.material.enlarged(scale)) for each in scene.surfaces),
        samples=min(scene.samples, FEWEST_SAMPLES),
        cells=min(scene.cells, FEWEST_CELLS),
    )


def _bent(device: Device, scale: float) -> tuple[float, ...]:
    """Coefficients of a lens that bends `scale` times as far, or at least so far that nobody would leave it out.

    In the picture's corner the small lens' slope stays below MOST_BENT, so that no picture folds over.
    """
    k1, k2, p1, p2, k3 = np.abs(device.distortion)
    square = device.tan_half[0] ** 2 + device.tan_half[1] ** 2
    slope = square * (3 * k1 + square * (5 * k2 + square * 7 * k3)) + 6 * np.sqrt(square) * (p1 + p2)
    most = max(1.0, min(scale, MOST_BENT / slope)) if slope else 1.0
    return tuple(most * each for each in device.distortion)


class _Judge:
    """The small room with all its effects, and windows of pictures as they are best shown in it."""

    def __init__(self, scene: Scene, needs: Mapping[str, Need]) -> None:
        self._scene, self._needs = _small(scene), needs
        self._whole = _Room(self._scene, needs)
        own, small = ((each.camera.height, each.camera.width) for each in (scene, self._scene))
        white, pictures = self._whole.tier.white, find_pictures(PICTURES)
        self._asked = [[white * each for each in _windows(picture.at(own), small)] for picture in pictures]
        self._best = [self._errors(self._whole, self._drives(self._whole, asked), asked) for asked in self._asked]

    def without(self, effects: Collection[str]) -> float:
        """Decibels that a room without some effects is off by, the worst picture's; infinite if it shows nothing."""
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
        """Mean squares, (windows,), of what a room makes of drives; of camera pixels that count in the whole one."""
        mask, white = self._whole.tier.calibration.mask, self._whole.tier.white
        errors = [(room.tier.seen(p) - each)[mask] / white for p, each in zip(drives, asked, strict=True)]
        return np.array([np.mean(np.square(each)) for each in errors])


def _lost(best: FloatArray, errors: FloatArray) -> float:
    """Decibels between the mean squares of two sets of windows."""
    return psnr(float(np.mean(best))) - psnr(float(np.mean(errors)))


def _windows(picture: FloatArray, shape: tuple[int, int]) -> list[FloatArray]:
    """Parts of a picture, of a shape (height, width), spread over it; the whole if it is no larger."""
    count = 1 if picture.shape[:2] == shape else WINDOWS
    tops, lefts = (
        [round(share * (whole - part)) for share in (np.arange(count) + 0.5) / count]
        for whole, part in zip(picture.shape, shape, strict=False)
    )
    return [picture[top : top + shape[0], left : left + shape[1]] for top in tops for left in lefts]


class _Room:
    """A scene simulated, some effects left out, and the best that its own T knows to show."""

    def __init__(self, scene: Scene, needs: Mapping[str, Need], without: Collection[str] = ()) -> None:
        result = simulate(scene, needs, without=without)
        self.tier = tier_of(simulated_calibration(scene, result), result.transport)
        objective = objective_of(self.tier.transport, self.tier.calibration, DEFAULT_AIMS, self.tier.mixing)
        self._box = Box(objective.unweighted, tolerance=GAP, most_steps=MOST_STEPS)

    def drive(self, asked: FloatArray) -> FloatArray:
        """(projector pixels, 3) for (camera height, camera width, 3), in screen primaries."""
        return self._box.solve(self.tier.asked(asked).reshape(-1, 3)).drive
