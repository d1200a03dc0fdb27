"""The default map, clamped, is never worse over all pictures than direct mapping or the plain pseudo-inverse."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight import calibration
from counterlight.maps.room_maps import read_maps
from counterlight.pipeline.operators import drive_of
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.inverse.build import build_room_maps
from counterlight.tools.inverse.near_light import InverseOptions
from counterlight.tools.inverse.pictures import typical_pictures
from counterlight.tools.simulation.room import fill_simulated_room
from counterlight.tools.simulation.simulate import simulate
from counterlight.tools.solve.registry import prepare
from counterlight.tools.transport.objective import DEFAULT_AIMS, ObjectiveOptions, objective_of
from counterlight.tools.transport.storage import read_transport
from tests.rooms import write_blurred_room
from tests.scenes import small

CAMERA, PROJECTOR = (36, 48), (24, 32)
# One λ serves all pictures. It damps poorly seen pixels, which costs a ramp at 39 dB 0.5 dB.
SINGLE_PICTURE_DB = 0.8


def pictures(shape: tuple[int, int]) -> list[np.ndarray]:
    """A photograph, letters, a ramp (λ is chosen on these), white, and a dark noisy picture that λ is not chosen on."""
    noise = cv2.GaussianBlur(np.random.default_rng(11).uniform(size=shape), (0, 0), 1.5)
    dark = 0.3 * (noise - noise.min()) / np.ptp(noise)
    return [np.repeat(grey[..., None], 3, axis=2) for grey in (*typical_pictures(shape), np.ones(shape), dark)]


@pytest.mark.parametrize("room", ["wall", "corner", "imported"])
def test_the_default_map_is_never_worse_than_direct_or_the_plain_inverse(room: str, tmp_path: Path) -> None:
    if room == "imported":
        write_blurred_room(tmp_path / room, np.random.default_rng(1), CAMERA, PROJECTOR)
    else:
        scene = replace(small(room, CAMERA, PROJECTOR), cells=150)
        with calibration.replacing(tmp_path / room) as stage:
            fill_simulated_room(scene, [simulate(scene)], stage)
    stored = calibration.read(tmp_path / room)
    maps = []
    for damping in (None, 0.0):
        build_room_maps(stored, InverseOptions(damping), ObjectiveOptions(drift=0))
        maps.append(read_maps(stored))
    tier = tier_of(stored.calibration, read_transport(stored))
    objective = objective_of(tier.transport, tier.calibration, DEFAULT_AIMS, tier.mixing)
    lit = objective.lit_picture(tier.calibration)
    mapping = prepare("direct", tier.transport.inside(lit), lit)

    def mean_squares(drive_of_target: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Return the mean squared error of each picture over the lit pixels, with the drive clamped."""
        found = []
        for picture in pictures(lit.shape):
            desired = tier.white * picture
            drive = np.clip(drive_of_target(tier.target(desired)), 0, 1)
            found.append(np.mean((tier.seen(drive) - desired)[lit] ** 2))
        return np.array(found)

    default, plain = (mean_squares(partial(drive_of, each)) for each in maps)
    for other in (mean_squares(lambda b: mapping.solve(b).unclamped), plain):
        assert np.mean(default) <= np.mean(other) * 1.001
        assert np.all(default <= other * 10 ** (SINGLE_PICTURE_DB / 10))
