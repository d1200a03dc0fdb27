"""Views of a room on the GPU against numpy: drives between views, in each view, and objects left after moving."""

import moderngl
import numpy as np
import pytest

from counterlight.passes.certificate import Inverse
from counterlight.pipeline.adjustments import Adjustments
from counterlight.pipeline.cpu_renderer import CpuCanvas
from counterlight.viewpoints import Viewpoint
from tests.renderers import both, on_gpu
from tests.viewed_rooms import as_set, letters, two_views

ATOL = 1e-5  # float32 sums, a few steps


def test_one_over_a_picture_matches_the_reference(gl_context: moderngl.Context, rng: np.random.Generator) -> None:
    picture = rng.uniform(0, 3, (11, 5, 3)).astype(np.float32) * (rng.uniform(size=(11, 5, 3)) < 0.7)
    found = on_gpu(gl_context, Inverse(picture), (11, 5))
    np.testing.assert_allclose(found, CpuCanvas((11, 5)).draw(Inverse(picture)), rtol=1e-6)  # a division in float32
    assert (found == 0).sum() == (picture == 0).sum() > 20


@pytest.mark.parametrize("far", [False, True])
def test_drives_between_views_equal_numpys(gl_context: moderngl.Context, far: bool) -> None:
    places: tuple[Viewpoint, ...] = ("all", ((0.2, 0),), ((1, 0),), ((0.9, 0),))
    with both(gl_context, as_set(two_views(far=far)), letters()) as renderers:
        for place in places:
            drives = []
            for renderer in renderers:
                renderer.adjust(Adjustments(viewpoint=place))
                renderer.upload(letters())
                for view in ("error", "projector"):
                    renderer.render(view, compensate=True, steps=3)
                drives.append(renderer.linear())
            np.testing.assert_allclose(*drives, atol=ATOL)
            assert 0.05 < drives[0].mean() < 0.95


def test_moving_makes_nothing_new(gl_context: moderngl.Context) -> None:
    """60 steps per second for a year: after the first step between views, no GL object is created."""
    with both(gl_context, as_set(two_views()), letters()) as (renderer, _):
        names = []
        for x in np.linspace(0.1, 0.9, 20):
            renderer.adjust(Adjustments(viewpoint=((float(x), 0),)))
            renderer.render("projector", compensate=True, steps=2)
            probe = gl_context.texture((1, 1), 1)
            names.append(probe.glo)
            probe.release()
        np.testing.assert_array_equal(np.diff(names[1:]), 1)  # consecutive names: only the probes got new names
