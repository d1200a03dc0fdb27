"""Blurred light on the GPU against the CPU function: drives, and the camera's view of them."""

import moderngl
import numpy as np
import pytest

from counterlight.media.frames import radiance_frame
from counterlight.pipeline.device import GpuPath
from counterlight.pipeline.room import Room
from counterlight.tools.colour.tiers import tier_of
from counterlight.tools.inverse.build import build_maps
from counterlight.tools.inverse.near_light import InverseOptions
from tests.blurred_rooms import CAMERA, calibrated, discs, in_blocks
from tests.renderers import both

ATOL = 1e-5  # the tolerance of all drives on the GPU


@pytest.mark.parametrize("path", [GpuPath("fragment"), GpuPath("compute"), GpuPath("auto", "auto")], ids=str)
def test_steps_and_views_match_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, path: GpuPath
) -> None:
    T = in_blocks(discs(rng, 6.0))
    made = build_maps(tier_of(calibrated(T), T), InverseOptions())
    room = Room(made.calibration, made.maps, made.maps.white, start="previous-direct")
    frame = radiance_frame(rng.choice([0.02, 0.3, 0.9], (*CAMERA, 3)).astype(np.float32))
    with both(gl_context, room, frame, path) as (gl, cpu):
        for view in ("projector", "camera", "error"):
            for renderer in (gl, cpu):
                renderer.render(view, compensate=True, steps=6)
            assert gl.linear().std() > 0.01
            np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL)
        found, expected = gl.certificate(), cpu.certificate()
        assert found is not None
        assert expected is not None
        np.testing.assert_allclose(found.gap, expected.gap, rtol=1e-4, atol=1e-5 * expected.squared_error.sum())
