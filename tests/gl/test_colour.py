"""Pictures through a camera whose channels see several primaries, on the GPU against the CPU function."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest

from counterlight.maps.mixing import Mixing
from counterlight.media.frames import radiance_frame
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.views import VIEWS
from tests.coloured_rooms import CROSSTALK, with_mixing
from tests.refined_rooms import physical_room
from tests.renderers import both
from tests.rooms import CAMERA, yuv_frame

# map colours change by up to 25 times the figures' change; the figures have errors of 5e-7, amplified up to 4 times
ATOL = 6e-5
PINNED = ((0.1, 0.15), (0.85, 0.05), (0.95, 0.9), (0.2, 0.8))
PICTURES = {
    "plain": Adjustments(),
    "adapted": Adjustments(adapt=5, black_level=0.03, flicker=0.4),
    "clipping": Adjustments(clipping=True, corners=PINNED),
}


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("media", ["video", "radiance"])
def test_every_view_through_a_mixing_matches_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, name: str, far: bool, media: str
) -> None:
    room = with_mixing(replace(physical_room(rng, far=far).room, white=0.9), rng)
    radiance = media == "radiance"
    frame = radiance_frame(rng.uniform(0, 1, (*CAMERA, 3)).astype(np.float32)) if radiance else yuv_frame(rng, (9, 15))
    with both(gl_context, room, frame) as (gl, cpu):
        for view in VIEWS:
            for renderer in (gl, cpu):
                renderer.adjust(PICTURES[name])
                renderer.render(view, compensate=True, steps=2)
            np.testing.assert_allclose(gl.linear(), cpu.linear(), atol=ATOL, err_msg=view)
        np.testing.assert_allclose(gl.desired(), cpu.desired(), atol=ATOL)


def test_one_matrix_for_the_room_changes_radiance_alone(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    """The global tier costs no time: the targets of a video stay bit-identical."""
    room = replace(physical_room(rng).room, white=0.9)
    room = replace(room, calibration=replace(room.calibration, ambient=0 * room.calibration.ambient))
    mixed = replace(room, maps=replace(room.maps, mixing=Mixing(CROSSTALK)))
    frames = yuv_frame(rng, (9, 15)), radiance_frame(rng.uniform(0, 1, (*CAMERA, 3)).astype(np.float32))
    for frame, alike in zip(frames, (True, False), strict=True):
        with both(gl_context, room, frame) as (gl, _), both(gl_context, mixed, frame) as (other, cpu):
            for renderer in (gl, other, cpu):
                renderer.render("projector", compensate=True)
            assert (gl.linear().tobytes() == other.linear().tobytes()) == alike
            np.testing.assert_allclose(other.linear(), cpu.linear(), atol=ATOL)
            np.testing.assert_allclose(other.desired(), cpu.desired(), atol=ATOL)
