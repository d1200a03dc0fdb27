"""Pictures on the shared screen of several cameras: content of each pixel, place of a corner, pointer positions."""

import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.overlay.outline import outline_on
from counterlight.passes.pinned import OnScreen, Pinned
from counterlight.pipeline.cpu_renderer import CpuDevice
from counterlight.pipeline.placement import Corners, homography
from counterlight.screen import Screen
from tests.oracles.formulas import pinned
from tests.oracles.renderer import ReferenceDevice
from tests.screens_of_cameras import split_screen

CAMERA, TOP = (30, 40), 17
WHOLE: Corners = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))


@pytest.fixture
def screen() -> Screen:
    return split_screen(CAMERA, TOP)


def test_each_pixel_shows_its_place_on_the_screen(screen: Screen) -> None:
    """A ramp as large as the screen shows each pixel's place.

    Camera pixels wider than screen pixels need uneven taps.
    """
    height, width = screen.shape
    v, u = np.mgrid[:height, :width] + 0.5
    ramp = np.stack([u, v, np.ones_like(u)], axis=2)
    shown = pinned(ramp, CAMERA, homography(WHOLE, screen.shape, screen.shape), *screen.axes)
    inner = np.all((screen.positions > 3) & (screen.positions < np.array([width, height]) - 3), axis=2)
    inner[:TOP, -1] = False  # pixels next to the narrower camera
    assert inner[:TOP].sum() > 200 < inner[TOP:].sum()
    np.testing.assert_allclose(shown[inner, :2], screen.positions[inner], atol=0.1)
    assert not shown[:TOP, -1].any()
    outside = np.any((screen.positions < -3) | (screen.positions > np.array([width, height]) + 3), axis=2)
    assert not shown[outside].any()


def test_a_screen_that_is_the_view_places_as_without(rng: np.random.Generator) -> None:
    """A row of the second camera continues where the first camera's row ends."""
    y, x = np.mgrid[:12, :17] + 0.5
    screen = Screen((12, 17), ((7, 17), (5, 17)), np.stack([x, y], axis=-1).astype(np.float32))
    picture, corners = rng.uniform(size=(31, 23, 3)), ((0.1, 0.05), (0.95, 0.1), (0.9, 0.9), (0.0, 0.8))
    H = homography(corners, screen.shape, (31, 23))  # type: ignore[arg-type]
    np.testing.assert_allclose(pinned(picture, (12, 17), H, *screen.axes), pinned(picture, (12, 17), H), atol=1e-12)


@pytest.mark.parametrize("size", [(9, 12), (400, 300)])
def test_compiled_passes_place_as_the_reference_does(
    rng: np.random.Generator, screen: Screen, size: tuple[int, int]
) -> None:
    source = rng.uniform(size=(*size, 3))
    H = homography(((0.1, 0.05), (0.95, 0.1), (0.9, 0.9), (0.0, 0.8)), screen.shape, size)
    drawn = []
    for device in (CpuDevice(), ReferenceDevice()):
        on_screen = OnScreen(*(device.picture(axis) for axis in screen.axes))
        made = Pinned(device.picture(source), tuple(H.T.ravel()), on_screen)
        drawn.append(device.canvas(CAMERA).draw(made))
    np.testing.assert_allclose(*drawn, atol=1e-5)  # float32 weights and sums


def test_what_is_pointed_at_is_where_the_pixel_looks(screen: Screen) -> None:
    points = np.array([(5.3, 2.9), (20.2, TOP + 3.1), (CAMERA[1] - 0.5, 2.0), (-1.0, 4.0)]) / CAMERA[::-1]
    found = screen.looked_at(points) * screen.shape[::-1]
    np.testing.assert_allclose(found[0], screen.positions[2, 5], rtol=1e-12)
    np.testing.assert_allclose(found[1], screen.positions[TOP + 3, 20], rtol=1e-12)
    assert np.isnan(found[2:]).all()  # pixels next to the narrower camera, and outside


def test_an_outline_runs_through_every_camera_that_sees_it(screen: Screen) -> None:
    corners: Corners = ((0.3, 0.2), (0.45, 0.2), (0.45, 0.6), (0.3, 0.6))
    outline = outline_on(screen, corners, None)
    pixels = (outline.points * CAMERA[::-1]).astype(int)
    ends = np.array(corners) * screen.shape[::-1]
    looks = screen.positions[pixels[:, 1], pixels[:, 0]]
    off = np.minimum(np.abs(looks - ends[0]), np.abs(looks - ends[2])).min(axis=1)
    assert off.max() < 1.7  # length of a pixel of the first camera on the screen
    assert (pixels[:, 1] < TOP).any()
    assert (pixels[:, 1] >= TOP).any()
    assert len(outline.handles) >= 4
    (handle,) = outline_on(screen, corners, 0).handles[:1]
    x, y = (handle * CAMERA[::-1]).astype(int)
    assert np.abs(screen.positions[y, x] - ends[0]).max() < 2


def test_a_screen_of_other_sizes_is_refused() -> None:
    with pytest.raises(InputError, match="size 1x9, expected 2 to 16384"):
        Screen((9, 9), ((9, 1), (9, 9)), np.zeros((18, 9, 2), np.float32))
    with pytest.raises(InputError, match="positions of 9x17 pixels, the cameras' raster is 9x18"):
        Screen((9, 9), ((9, 9), (9, 9)), np.zeros((17, 9, 2), np.float32))
