"""Light outside the camera's view: momentum carried through a film does not build it up, from any start."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.calibration import Calibration, Device
from counterlight.media.frames import radiance_frame
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.operators import drive_of
from counterlight.pipeline.refinement import STARTS
from counterlight.pipeline.room import Room
from counterlight.response import Response
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.inverse.build import build_maps
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.solve.box import Box
from counterlight.tools.transport.mask import directly_lit
from counterlight.tools.transport.objective import DEFAULT_AIMS, Objective, ObjectiveOptions, objective_of
from counterlight.tools.transport.transport import Transport

CAMERA, PROJECTOR, LINEAR = (16, 26), (11, 20), Response("linear")
FRAMES = 12
# momentum overshoots a moving optimum, and four steps fall short of it; the largest excess seen was 10 %
OVERSHOOT = 1.2
UNSEEN = 1e-3  # share of the light that most projector pixels give the camera


@cache
def room(width: float) -> tuple[Room, Objective]:
    """Return a wall whose raster ends inside the camera's view on the left and below, and outside it elsewhere.

    width : σ of the footprints, projector pixels.
    """
    rng = np.random.default_rng(0)
    y, x = ((np.arange(n) + 0.5) / n for n in CAMERA)
    down = _footprints(4 + (PROJECTOR[0] - 3) * y, PROJECTOR[0], width)
    across = _footprints((PROJECTOR[1] - 6) * x - 2, PROJECTOR[1], width)
    T = np.kron(down, across) * rng.uniform(0.3, 1, (CAMERA[0] * CAMERA[1], 1))
    near = [sparse.csr_array(np.where(T > 1e-4, tint * T, 0).astype(np.float32)) for tint in (1, 0.9, 0.8)]
    transport = Transport.from_matrices(near, camera=CAMERA, projector=PROJECTOR)
    ambient = np.full((*CAMERA, 3), 0.01, np.float32)
    mask = directly_lit(transport, ambient, PROJECTOR)
    devices = (Device(*PROJECTOR, LINEAR),), Device(*CAMERA, LINEAR)
    calibration = Calibration("edge", "made by a test", *devices, ambient, mask)
    maps = build_maps(tier_of(calibration, transport), InverseOptions()).maps
    return Room(calibration, maps, maps.white), objective_of(transport, calibration, DEFAULT_AIMS)


def _footprints(places: FloatArray, count: int, width: float) -> FloatArray:
    away = places[:, None] - np.arange(count) - 0.5
    return np.asarray(np.exp(-(away**2) / (2 * width**2)) / (np.sqrt(2 * np.pi) * width))


def film(white: float) -> list[np.ndarray]:
    """Return hard stripes that move, so that every frame needs other drives at the view's edge."""
    y, x = np.mgrid[: CAMERA[0], : CAMERA[1]]
    stripes = [0.6 + 0.4 * np.sign(np.sin((x + 1.3 * k) / 3 + y / 4)) for k in range(FRAMES)]
    return [np.repeat(white * each[..., None], 3, axis=2).astype(np.float32) for each in stripes]


def drives(room: Room, frames: list[np.ndarray], steps: int) -> list[FloatArray]:
    renderer, found = CpuRenderer(room), []
    renderer.open(radiance_frame(frames[0]).format)
    for frame in frames:
        renderer.upload(radiance_frame(frame))
        renderer.render("projector", compensate=True, steps=steps)
        found.append(np.asarray(renderer.linear().reshape(-1, 3), np.float64))
    return found


def outside(objective: Objective, shown: list[FloatArray]) -> float:
    """Return the largest light outside over all frames, as a share of full drive."""
    return max(objective.light_outside(drive) or 0.0 for drive in shown)


@pytest.mark.parametrize("width", [0.4, 0.8, 1.6])
@pytest.mark.parametrize("start", STARTS)
def test_light_outside_is_at_most_what_the_best_pictures_have(start: str, width: float) -> None:
    """Few and many steps stay near the optimum, in a film and a still. Pixels that no camera pixel sees stay dark."""
    edge, objective = room(width)
    ambient, playing = edge.ambient, replace(edge, start=start)
    frames = film(edge.white)
    best = [Box(objective).run((frame - ambient).reshape(-1, 3).astype(np.float64))[0] for frame in frames]
    unseen = objective.seen < UNSEEN
    assert unseen.sum() >= 30
    for steps in (4, 16, 64):
        shown = drives(playing, frames, steps)
        assert outside(objective, shown) <= OVERSHOOT * outside(objective, best)
        assert max(drive[unseen].max() for drive in shown) < 0.01
    still = drives(playing, frames[:1] * FRAMES, 4)
    assert outside(objective, still) <= OVERSHOOT * outside(objective, best[:1])


def test_without_the_prior_it_would_be_more() -> None:
    """The prior that draws unseen pixels to black limits this light: the same film without the prior shows more."""
    edge, objective = room(0.8)
    further = edge.maps.refinement
    assert further is not None
    undrawn = replace(further.prior, damping=0 * further.prior.damping)
    free = replace(edge, maps=replace(edge.maps, refinement=replace(further, prior=undrawn)))
    held, let = (outside(objective, drives(each, film(edge.white), 64)) for each in (edge, free))
    assert let > 1.5 * held


@pytest.mark.parametrize("inverse", ["whole", "none"])
@pytest.mark.parametrize("outside", ["black", "continue"])
def test_without_a_step_the_map_alone_keeps_it_dark_or_goes_on(outside: str, inverse: str) -> None:
    """Two projectors share a raster. The camera does not see the edges at which their regions meet.

    Each projector's picture is continued by itself.
    """
    projector, camera, width = (4, 12), (8, 24), 6
    T = np.kron(np.eye(48), np.ones((4, 1)))
    unseen = np.tile((np.arange(12) > 3) & (np.arange(12) < 9), 4)
    T[:, unseen] = 0
    transport = Transport.from_matrices(
        [sparse.csr_array(T.astype(np.float32))] * 3, camera=camera, projector=projector
    )
    mask = (T.sum(axis=1) > 0).reshape(camera)
    devices = (Device(4, width, LINEAR), Device(4, width, LINEAR)), Device(*camera, LINEAR)
    calibration = Calibration("two", "made by a test", *devices, np.zeros((*camera, 3), np.float32), mask)
    options, aims = InverseOptions(inverse=inverse), ObjectiveOptions(outside=outside)
    maps = build_maps(tier_of(calibration, transport), options, aims, refine=False).maps
    left = np.tile(np.arange(12) < width, 4)
    b = (T @ np.where(left, 0.8, 0.2))[:, None] * np.ones(3)
    drive = drive_of(maps, b.reshape(*camera, 3)).reshape(-1, 3)
    if outside == "black":
        assert not drive[unseen].any()
    else:
        expected = np.where(left, 0.8, 0.2)[unseen, None] * np.ones(3)
        np.testing.assert_allclose(drive[unseen], expected, atol=0.02)  # error by damping and ties
