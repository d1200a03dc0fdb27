"""Moved pictures: the pass against the CPU function, alone and in the player's chain."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest

from counterlight.passes.moved import MovedDrive
from counterlight.pipeline.cpu_renderer import CpuCanvas
from counterlight.pipeline.drift import Drift, Moved
from counterlight.raster import Region
from tests.drifted_rooms import moved_by
from tests.oracles.formulas import moved
from tests.renderers import both, on_gpu
from tests.rooms import random_room, yuv_frame

REGIONS = Region(0, 0, 13, 7), Region(13, 0, 11, 5), Region(24, 0, 4, 7), Region(0, 7, 12, 6)
# Positions up to 28 pixels in float32 are wrong by 28 · 2⁻²³ and some roundings. Random drives have slopes below 4.
ATOL = 1e-4


def some(rng: np.random.Generator, reach: float) -> Moved:
    N = np.eye(3) + reach * rng.uniform(-1, 1, (3, 3)) * [[0.02, 0.02, 1], [0.02, 0.02, 1], [2e-3, 2e-3, 0]]
    return Moved(N, rng.uniform(0.8, 1.25, 3))


@pytest.mark.parametrize("reach", [0.0, 0.3, 1.0, 4.0])
def test_the_pass_matches_the_reference(gl_context: moderngl.Context, rng: np.random.Generator, reach: float) -> None:
    drive = rng.uniform(0, 1, (14, 28, 3)).astype(np.float32)
    table = Drift(tuple(some(rng, reach) for _ in REGIONS)).table(REGIONS)
    made = MovedDrive(drive, table)
    result = on_gpu(gl_context, made, (14, 28))
    for expected in (moved(drive, table), CpuCanvas((14, 28)).draw(made)):
        np.testing.assert_allclose(result, expected, atol=ATOL)


def test_the_chain_matches_the_reference_and_identity_is_left_out(
    gl_context: moderngl.Context, rng: np.random.Generator
) -> None:
    plain, frame = random_room(rng, far=True), yuv_frame(rng, (9, 15))
    found = {}
    drifts: dict[str, Drift | None] = {
        "none": None,
        "identity": Drift((Moved.nothing(),)),
        "moved": Drift((moved_by(0.8, -0.6, 0.9),)),
    }
    share = rng.uniform(0.5, 1, plain.calibration.camera.shape).astype(np.float32)
    drifts["shared"] = Drift((moved_by(0.8, -0.6, 0.9),), share=share)
    for name, drift in drifts.items():
        with both(gl_context, replace(plain, drift=drift), frame) as (gpu, cpu):
            for renderer in (gpu, cpu):
                renderer.render("projector", compensate=True)
            np.testing.assert_allclose(gpu.linear(), cpu.linear(), atol=ATOL)
            found[name] = gpu.linear().copy(), gpu.encoded().copy()
    for none, identity, other, shared in zip(*found.values(), strict=True):
        np.testing.assert_array_equal(none, identity)
        assert not np.array_equal(none, other)
        assert not np.array_equal(other, shared)
