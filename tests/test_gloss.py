"""Highlights of one projector, found from the ratio of two projectors' light, and drives that avoid them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from counterlight.calibration import Calibration, Device
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.inverse.build import build_maps
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.solve.box import Box
from counterlight.tools.transport.gloss import glossy
from counterlight.tools.transport.objective import ObjectiveOptions, objective_of, owners
from counterlight.tools.transport.transport import Transport

SHAPE = (24, 32)
AVOID = ObjectiveOptions(avoid_highlights=True)
WANTED = 0.2


class Pair:
    """Two projectors on rough paint, one pixel of each per camera pixel; the first projector has a highlight."""

    def __init__(self, rng: np.random.Generator) -> None:
        y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 20
        self.paint = rng.uniform(0.2, 0.9, SHAPE)
        self.gloss = 1.5 * np.exp(-((x - 0.8) ** 2 + (y - 0.6) ** 2) / 0.03)
        first, second = np.exp(-0.3 * x + 0.1 * y), np.exp(0.2 * x - 0.05 * x * y)
        self.lights = [self.paint * first * (1 + self.gloss), self.paint * second]

    def room(self) -> tuple[Calibration, Transport]:
        blocks = [sparse.diags_array(light.ravel()) for light in self.lights]
        columns = np.arange(2 * SHAPE[1] * SHAPE[0]).reshape(SHAPE[0], 2, SHAPE[1])  # side by side in the raster
        order = np.argsort(np.concatenate([columns[:, 0].ravel(), columns[:, 1].ravel()]))
        T = sparse.csr_array(sparse.csc_array(sparse.hstack(blocks))[:, order], dtype=np.float32)
        devices = (Device(*SHAPE, Response("linear")),) * 2, Device(*SHAPE, Response("linear"))
        dark = np.zeros((*SHAPE, 3), np.float32)
        room = Calibration("pair", "made by a test", *devices, dark, np.ones(SHAPE, bool))
        return room, Transport.from_matrices([T] * 3, camera=SHAPE, projector=room.projector.shape)


def shares_in(room: Calibration, T: Transport) -> np.ndarray:
    return glossy(T, room, owners(room.projector.shape, room.regions))


def of_each(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    raster = values.reshape(SHAPE[0], 2, SHAPE[1])
    return raster[:, 0], raster[:, 1]


def test_a_highlight_is_found_whatever_the_paint(rng: np.random.Generator) -> None:
    pair = Pair(rng)
    room, T = pair.room()
    first, second = of_each(shares_in(room, T))
    truth = pair.gloss / (1 + pair.gloss)
    # the fitted surface is quadratic, and the ratio in these rooms is nearly quadratic
    assert np.abs(first - truth)[truth > 0.15].max() < 0.03
    assert not first[truth < 0.05].any()
    assert not second.any()


def test_where_the_other_one_throws_a_shadow_nobody_is_spared(rng: np.random.Generator) -> None:
    pair = Pair(rng)
    pair.gloss[:] = 0
    pair.lights[0] = pair.lights[0] / (1 + Pair(np.random.default_rng(0)).gloss)
    pair.lights[1][4:12, 20:28] *= 0.05
    assert not shares_in(*pair.room()).any()


def test_the_other_projector_lights_the_highlight_and_nothing_is_lost(rng: np.random.Generator) -> None:
    pair, spot = Pair(rng), (12, 16)
    room, T = pair.room()
    b = WANTED * np.repeat(pair.paint.reshape(-1, 1), 3, axis=1)
    drives = [Box(objective_of(T, room, aims), tolerance=1e-6).solve(b).drive for aims in (ObjectiveOptions(), AVOID)]
    shared, avoided = (of_each(drive[:, 1]) for drive in drives)
    assert avoided[0][spot] < 0.4 * shared[0][spot]  # pixels at the spot's rim are tied to it (drift)
    assert np.abs(T.apply(drives[1]) - b).max() < 0.02 * b.max()


def test_maps_are_built_for_it_and_one_projector_is_refused(rng: np.random.Generator) -> None:
    room, T = Pair(rng).room()
    tier = tier_of(room, T)
    grey = np.full((T.shape[0], 3), 0.3 * tier.white)
    drives = [
        build_maps(tier, InverseOptions(inverse="whole"), aims, refine=False).inverse.T_pinv.apply(grey)
        for aims in (ObjectiveOptions(), AVOID)
    ]
    plain, avoided = (of_each(drive[:, 1])[0][12, 16] for drive in drives)
    assert avoided < 0.5 * plain
    with pytest.raises(InputError, match="--avoid-highlights: of one projector"):
        objective_of(T, replace(room, projectors=(Device(SHAPE[0], 2 * SHAPE[1], Response("linear")),)), AVOID)
