"""Fades on GPU and CPU against numpy functions, and the functions against a formula."""

import moderngl
import numpy as np
import pytest

from counterlight.gl.renderer import GlRenderer
from counterlight.media.frames import Frame, radiance_frame
from counterlight.pipeline.adjustments import NEUTRAL, Adjustments
from counterlight.pipeline.cpu_renderer import CpuRenderer
from counterlight.pipeline.renderer import AnyRenderer
from tests.gl_objects import live_objects
from tests.oracles.renderer import ReferenceRenderer
from tests.rooms import CAMERA, random_room, rgb_frame, yuv_frame

ATOL = 1e-5  # float32 sums of at most a few hundred terms of small size
LEVEL, WEIGHT = 0.625, 0.25
PINNED = ((0.1, 0.1), (0.9, 0.0), (0.9, 0.9), (0.0, 1.0))
VIEWS = "projector", "camera", "error", "split"


def crossing(renderer: AnyRenderer, before: Frame, now: Frame, adjustments: Adjustments = NEUTRAL) -> AnyRenderer:
    """Crossfade between two frames, with WEIGHT of the first left, and both darkened."""
    renderer.open(before.format)
    renderer.adjust(adjustments)
    renderer.upload(before)
    renderer.render("projector", compensate=True)
    renderer.open(now.format, crossfade=True)
    renderer.upload(now)
    renderer.fade(LEVEL, WEIGHT)
    return renderer


@pytest.mark.parametrize("adjustments", [NEUTRAL, Adjustments(corners=PINNED), Adjustments(black_level=0.1, adapt=2)])
@pytest.mark.parametrize("radiance", [False, True])
def test_fades_match_the_reference(
    gl_context: moderngl.Context, rng: np.random.Generator, adjustments: Adjustments, radiance: bool
) -> None:
    room = random_room(rng, far=True)
    before = yuv_frame(rng, (9, 15))
    other = radiance_frame(rng.uniform(0, room.white, (*CAMERA, 3)).astype(np.float32))
    now = other if radiance else rgb_frame(rng.integers(0, 256, (40, 61, 3), np.uint8))
    made = GlRenderer(gl_context, room), CpuRenderer(room), ReferenceRenderer(room)
    try:
        for view in VIEWS:
            for compensate in (True, False):
                for renderer in made:
                    crossing(renderer, before, now, adjustments)
                    renderer.render(view, compensate=compensate)
                *drawn, meant = (renderer.linear() for renderer in made)
                for light in drawn:
                    np.testing.assert_allclose(light, meant, atol=ATOL, err_msg=f"{view} {compensate}")
                assert meant.std() > 0
    finally:
        made[0].release()


def test_a_fade_asks_for_blended_light_before_it_is_compensated(rng: np.random.Generator) -> None:
    room = random_room(rng, far=True)
    frames = yuv_frame(rng, (9, 15)), radiance_frame(rng.uniform(0, room.white, (*CAMERA, 3)).astype(np.float32))
    asked = []
    for frame in frames:
        alone = ReferenceRenderer(room)
        alone.open(frame.format)
        alone.upload(frame)
        asked.append(alone.desired())
    for before, now in ((0, 1), (1, 0)):
        renderer = crossing(ReferenceRenderer(room), frames[before], frames[now])
        expected = LEVEL * ((1 - WEIGHT) * asked[now] + WEIGHT * asked[before])
        np.testing.assert_allclose(renderer.desired(), expected, rtol=1e-6)  # float32, a few operations
        renderer.fade(1.0)
        renderer.end_crossfade()
        np.testing.assert_allclose(renderer.desired(), asked[now], rtol=1e-6)
    renderer.fade(0.0)
    renderer.render("projector", compensate=True)
    assert not renderer.desired().any()


def test_a_crossfade_gives_up_what_it_held(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    """Media of one format alternate. After many crossfades, there are as many GL objects as after the first."""
    frame = yuv_frame(rng, (9, 15))
    renderer = GlRenderer(gl_context, random_room(rng, far=False))
    counts = []
    for _ in range(4):
        crossing(renderer, frame, frame)
        renderer.end_crossfade()
        counts.append({kind: len(names) for kind, names in live_objects().items()})
    renderer.release()
    assert all(count == counts[0] for count in counts)
