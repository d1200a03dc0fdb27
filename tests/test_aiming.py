"""Advice of the live picture (framing, focus, exposure), and the folder for aiming with other programs."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from counterlight.errors import InputError
from counterlight.gl.monitors import Monitor
from counterlight.tools.acquisition.aiming import brightest, framing, sharpness, shown
from counterlight.tools.acquisition.cameras.folder import AimedFolder
from counterlight.tools.acquisition.preview import preview_monitor

MARK = (255, 0, 160)


def views(rng: np.random.Generator, box: tuple[int, int, int, int], noise: float = 0.004) -> list[np.ndarray]:
    """Returns captures of black, black and white in a textured view of 100x160; the projector lights the box.

    box : (top, left, bottom, right).
    """
    top, left, below, right = box
    wall = rng.uniform(0.2, 0.8, (100, 160, 3))
    light = np.zeros((100, 160, 1))
    light[top:below, left:right] = 1
    return [0.05 + wall * light * on + noise * rng.standard_normal(wall.shape) for on in (0, 0, 1)]


def test_margins_are_those_of_the_picture(rng: np.random.Generator) -> None:
    found = framing(*views(rng, (10, 24, 85, 152)))
    assert found is not None
    margins = found.left, found.above, found.right, found.below
    # the corners that the median gives
    assert np.allclose(margins, (24 / 160, 10 / 100, 8 / 160, 15 / 100), atol=0.011)
    assert found.filled == pytest.approx(75 * 128 / 16000, abs=0.01)
    assert str(found) == "the picture is inside the view, margins of 5 % and more; it fills 60 %"


@pytest.mark.parametrize(
    ("box", "said"),
    [
        ((10, 0, 90, 140), "reaches the left edge of the view: turn the camera, zoom out"),
        ((0, 20, 100, 140), "reaches the upper and lower edge"),
        ((0, 0, 100, 160), "reaches the left, right, upper and lower edge"),
        ((40, 60, 60, 90), "fills 4 % of the view: zoom in"),
    ],
)
def test_what_is_wrong_is_said(rng: np.random.Generator, box: tuple[int, int, int, int], said: str) -> None:
    assert said in str(framing(*views(rng, box)))


def test_noise_alone_is_no_picture(rng: np.random.Generator) -> None:
    assert framing(*views(rng, (0, 0, 0, 0), noise=0.05)) is None
    assert framing(*views(rng, (0, 0, 0, 0), noise=0)) is None


def test_focus_is_where_sharpness_is_highest(rng: np.random.Generator) -> None:
    wall = np.repeat(rng.uniform(0.1, 0.9, (300, 400, 1)), 3, axis=2)
    blurs = [wall if sigma == 0 else cv2.GaussianBlur(wall, (0, 0), sigma) for sigma in (3, 2, 1, 0.5, 0)]
    values = [sharpness(blurred) for blurred in blurs]
    assert values == sorted(values)
    assert sharpness(0.5 * wall) == pytest.approx(values[-1], rel=1e-9)


def test_brightest_leaves_hot_pixels_out(rng: np.random.Generator) -> None:
    shot = rng.integers(0, 32768, (300, 400)).astype(np.uint16)
    shot[0, :5] = 65535
    assert brightest(shot) == pytest.approx(0.5, abs=0.002)
    assert brightest(np.full((20, 30, 3), 255, np.uint8)) == 1


@pytest.mark.parametrize("shape", [(60, 80), (30, 40), (120, 160)])
def test_a_single_clipped_pixel_is_marked(shape: tuple[int, int]) -> None:
    light, clipped = np.full((60, 80, 3), 0.2), np.zeros((60, 80), np.bool_)
    clipped[31, 47] = True
    picture = shown(light, clipped, shape, MARK)
    marked = np.all(picture == MARK, axis=2)
    scale = shape[0] / 60
    assert picture.shape == (*shape, 3)
    assert marked[int(31 * scale), int(47 * scale)]
    assert marked.sum() == max(1, scale**2)
    assert np.all(picture[~marked] == round(255 * 0.2 ** (1 / 2.2)))


def test_the_preview_goes_where_the_projector_is_not() -> None:
    desk, beamer = Monitor(0, "DP-1", 1920, 1080, 60, 0, 0, True), Monitor(1, "HDMI-1", 1024, 768, 60, 1920, 0, False)
    assert preview_monitor([desk, beamer], ["HDMI-1"]) == desk
    assert preview_monitor([desk, beamer], ["0"]) == beamer
    assert preview_monitor([desk], []) == desk
    with pytest.raises(InputError, match="--preview needs a monitor besides the projector's"):
        preview_monitor([desk, beamer], ["HDMI-1", "DP-1"])


def test_a_folder_shows_what_is_to_be_shown_and_reads_the_newest_photograph(tmp_path: Path) -> None:
    folder = AimedFolder(tmp_path, (12, 16))
    folder.show(np.full((12, 16, 3), 255, np.uint8))
    assert np.all(cv2.imread(str(tmp_path / "aim" / "pattern.png")) == 255)
    assert folder.frame().max() == 0
    assert "waiting for a photograph" in folder.name
    cv2.imwrite(str(tmp_path / "aim" / "one.png"), np.full((20, 30, 3), 77, np.uint8))
    assert np.all(folder.frame() == 77)
    (tmp_path / "aim" / "two.jpg").write_bytes(b"\xff\xd8 half a fi")
    assert np.all(folder.frame() == 77)
    assert folder.name == "one.png"
    with pytest.raises(InputError, match="set at the camera"):
        folder.expose(0.1)
