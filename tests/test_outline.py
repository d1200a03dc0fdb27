"""The outline while a picture is placed: its points, the places that the projector lights, when it appears."""

import numpy as np
import pytest

from counterlight.gl.presenter import overlay_of
from counterlight.maps.row_map import RowMap, SparseRows, pack
from counterlight.overlay.osd import Page
from counterlight.overlay.outline import GROUND, INK, SELECTED, Outline, draw_outline, lit_by, outline_of
from counterlight.pipeline.placement import Corners
from counterlight.raster import Region
from tests.stage import Stage

CAMERA, PROJECTOR = (4, 6), (3, 5)
PINNED: Corners = ((0.0, 0.0), (1.0, 0.0), (1.0, 0.5), (0.0, 0.5))


def test_points_run_round_the_corners_a_camera_pixel_apart() -> None:
    outline = outline_of(PINNED, None, CAMERA)
    top, right = [(k / 6, 0.0) for k in range(6)], [(1.0, k / 4) for k in range(2)]
    bottom, left = [(1 - k / 6, 0.5) for k in range(6)], [(0.0, 0.5 - k / 4) for k in range(2)]
    np.testing.assert_allclose(outline.points, [*top, *right, *bottom, *left], atol=1e-15)
    np.testing.assert_array_equal(outline.handles, PINNED)
    np.testing.assert_array_equal(outline_of(PINNED, 2, CAMERA).handles, [PINNED[2]])


@pytest.mark.parametrize("wide", [False, True])
def test_a_point_stands_where_the_projector_lights_it_most(wide: bool) -> None:
    """Projector pixels (1, 0) and (4, 2) light camera pixel (2, 1), the second more. (0, 1) lights the last pixel."""
    lengths = np.zeros(24, np.int64)
    lengths[1 * 6 + 2], lengths[-1] = 2, 1
    rows = SparseRows(
        np.concatenate([[0], np.cumsum(lengths)]),
        np.array([1, 2 * 5 + 4, 5]),
        np.array([[0.5, 0, 0.1], [0.1, 0.4, 0.2], [1, 0, 0]], np.float32),
        PROJECTOR[0] * PROJECTOR[1],
    )
    transport = pack(rows, CAMERA, PROJECTOR)
    if wide:
        index = transport.entries[..., 3].astype(np.uint32)
        entries = transport.entries * np.array([1, 1, 1, 0], np.float32)
        transport = RowMap(transport.lookup, entries, PROJECTOR, index)
    asked = np.array([(2.5 / 6, 1.5 / 4), (1.0, 1.0), (3.5 / 6, 1.5 / 4), (1.01, 0.5), (-0.1, 0.5)])
    lit, last, nowhere = (4.5 / 5, 2.5 / 3), (0.5 / 5, 1.5 / 3), (np.nan, np.nan)
    np.testing.assert_allclose(lit_by(transport, asked), [lit, last, nowhere, nowhere, nowhere], rtol=1e-15)


def test_dots_are_edged_handles_lie_over_them_and_nothing_is_drawn_outside() -> None:
    canvas = np.zeros((40, 60, 4), np.uint8)
    outline = Outline(np.array([(30.5, 20.5), (np.nan, 1.0), (200.0, 5.0), (-3.0, -3.0)]), np.array([(50.0, 10.0)]))
    draw_outline(canvas, outline, lambda points: points, 1.0)
    colours, counts = np.unique(canvas.reshape(-1, 4), axis=0, return_counts=True)
    found = {tuple(int(c) for c in colour): int(n) for colour, n in zip(colours, counts, strict=True)}
    corner = 1  # the edge from (-3, -3) ends at pixel 0
    assert found[INK] == 3 * 3
    assert found[SELECTED] == 13 * 13
    assert found[GROUND] == 7 * 7 - 3 * 3 + 17 * 17 - 13 * 13 + corner
    assert tuple(canvas[20, 30]) == INK
    assert tuple(canvas[10, 50]) == SELECTED


def test_in_a_window_the_outline_follows_the_part_that_is_shown() -> None:
    """A point is at (12, 3) of a raster of 20x10. A window shows the half from x = 10 at twice its size at (4, 2)."""
    page = Page((), outline=Outline(np.array([(12.5 / 20, 3.5 / 10)]), np.empty((0, 2))))
    overlay = overlay_of(page, (40, 30), (20, 10), Region(10, 0, 10, 10), (4, 2, 20, 20))
    assert overlay.shape == (30, 40, 4)
    rows, columns = np.nonzero((overlay == INK).all(axis=2))
    assert (rows.mean(), columns.mean()) == (2 + 7, 4 + 5)
    assert not overlay[:, :4].any()  # left of the picture
    assert not overlay_of(page, (40, 30), None, Region(0, 0, 1, 1), (4, 2, 20, 20)).any()  # a black window stays black
    text = overlay_of(Page(("text",), outline=page.outline), (400, 300), (20, 10), Region(0, 0, 20, 10), (0, 0, 20, 10))
    assert text[5, 5, 3] > 0
    assert not text[200, 300].any()


def test_it_is_shown_while_the_picture_is_placed() -> None:
    stage = Stage()
    stage.advance(0.1)
    assert stage.screen.pages[-1] is None
    stage.press("k", "tab")
    page = stage.screen.pages[-1]
    assert page is not None
    assert page.outline is not None
    np.testing.assert_array_equal(page.outline.handles, [(0, 0)])
    assert page.outline.points.max() == 0.5  # the view of the projector, where the test's room halves positions
    shown = len(stage.screen.pages)
    stage.show.step()
    assert len(stage.screen.pages) == shown  # nothing has changed, so nothing is drawn again
    stage.press("v")
    camera = stage.screen.pages[-1]
    assert camera is not None
    assert camera.outline is not None
    assert camera.outline.points.max() == 1
    stage.press("i")
    with_statistics = stage.screen.pages[-1]
    assert with_statistics is not None
    assert with_statistics.outline is camera.outline
    stage.press("i", "escape")
    stage.advance(2.0)
    assert stage.screen.pages[-1] is None
