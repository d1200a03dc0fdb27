"""Small copies of rendered pictures: the GPU agrees with the CPU functions, and the copies with their views."""

import moderngl
import numpy as np
import pytest

from counterlight.gl.device import GlDevice
from counterlight.pipeline.shown_copies import LONGEST, SmallPicture
from counterlight.pipeline.views import VIEWS
from counterlight.response import Response
from tests.oracles import encoding
from tests.oracles.renderer import ReferenceDevice
from tests.renderers import both
from tests.rooms import random_room, rgb_frame

CODE_ATOL = 1  # a float32 rounding may tip one code value


def test_blocks_are_averaged_in_linear_light(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    shape, side, white = (2 * LONGEST - 7, 3 * LONGEST - 2), 3, 2.5
    light = rng.uniform(0, 1.2 * white, (*shape, 3)).astype(np.float32)
    rows, columns = shape[0] // side, shape[1] // side
    means = light[: rows * side, : columns * side].reshape(rows, side, columns, side, 3).mean(axis=(1, 3))
    table = Response("srgb").inverse_table()
    expected = encoding.encode(means, table, white).astype(int)
    for device in (GlDevice(gl_context), ReferenceDevice()):
        small, picture = SmallPicture(device, shape, white), device.picture(light)
        found = device.read(small.run(picture), np.uint8)
        assert found.shape == (rows, columns, 3)
        np.testing.assert_allclose(found.astype(int), expected, atol=CODE_ATOL)
        small.release()
        if isinstance(device, GlDevice):
            picture.release()
        device.release()


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("compensate", [True, False])
def test_what_is_shown_and_what_the_camera_sees_of_it(
    gl_context: moderngl.Context, rng: np.random.Generator, view: str, compensate: bool
) -> None:
    """Pictures of a small room keep their size. Only their codes differ from the views' codes."""
    room = random_room(rng, far=True)
    frame = rgb_frame(rng.integers(0, 256, (9, 14, 3)).astype(np.uint8))
    with both(gl_context, room, frame) as renderers:
        for renderer in renderers:
            assert renderer.small() is renderer.small_seen() is None  # nothing has been rendered
            renderer.render("camera", compensate=compensate)
            seen = renderer.encoded().astype(int)
            renderer.render(view, compensate=compensate)
            shown, predicted = renderer.small(), renderer.small_seen()
            assert shown is not None
            if view != "projector":
                np.testing.assert_allclose(shown.astype(int), renderer.encoded(), atol=CODE_ATOL)
            if view == "impossible":
                assert predicted is None
            elif view in ("projector", "camera"):
                np.testing.assert_allclose(predicted.astype(int), seen, atol=CODE_ATOL)
            renderer.open(frame.format)
            assert renderer.small() is None
