"""The on-screen display: ink stays inside the page, bars grow, messages fade."""

from pathlib import Path

import numpy as np
import pytest

from counterlight.overlay import letters
from counterlight.overlay.letters import plain
from counterlight.overlay.osd import GROUND_ALPHA, Histogram, Legend, Message, Page, draw, pages

WINDOW = (720, 1280)


def inked(pixels: np.ndarray) -> tuple[int, int]:
    """Return the (bottom, right) pixel of the text."""
    rows, columns = np.nonzero(pixels[..., 0] > 128)
    return int(rows.max()), int(columns.max())


def test_a_page_is_as_large_as_its_text_and_never_larger_than_the_window() -> None:
    short, long = (draw(Page(lines), WINDOW) for lines in (("one",), ("one", "a longer line", "three")))
    assert short.shape[0] < long.shape[0]
    assert short.shape[1] < long.shape[1]
    for page in (short, long):
        assert np.all(np.array(inked(page)) < page.shape[:2])  # no text is cut off
        assert page.dtype == np.uint8
    tall = Page(tuple(f"line {index}\twith a second column" for index in range(30)))
    assert draw(tall, WINDOW).shape[0] <= 720
    for window in ((75, 100), (1, 1), (20, 3000)):
        height, width = draw(tall, window).shape[:2]
        assert 1 <= height <= window[0]
        assert 1 <= width <= window[1]


def test_text_grows_with_the_window_and_with_its_size() -> None:
    page = Page(("Pause: on",))
    low, high = (draw(page, (height, 4000)).shape for height in (720, 1440))
    assert high[0] == pytest.approx(2 * low[0], abs=1)
    assert high[1] == pytest.approx(2 * low[1], rel=0.03)  # glyphs are hinted to whole pixels
    assert draw(Page(page.lines, size=2), (720, 4000)).shape == high


def test_columns_stand_below_each_other() -> None:
    wide = draw(Page(("a\tX", "a long first cell\tX")), WINDOW)
    half = wide.shape[0] // 2
    assert inked(wide[:half])[1] == inked(wide[half:])[1]


def test_opacity_scales_alpha_alone() -> None:
    full, half = (draw(Page(("text",), opacity=opacity), WINDOW) for opacity in (1.0, 0.5))
    np.testing.assert_array_equal(full[..., :3], half[..., :3])
    np.testing.assert_allclose(half[..., 3], full[..., 3] / 2, atol=1)  # rounding to one code
    assert full[..., 3].min() == round(255 * GROUND_ALPHA)
    assert full[..., 3].max() == 255


def test_bars_are_as_high_as_their_counts() -> None:
    counts = (10, 5, 0, 20)
    pixels = draw(Page(("title",), Histogram(counts, ("a", "b", "c", "d"))), WINDOW)
    bars = pixels[..., 0] == 200  # the grey of the bars
    heights = [int(bars[:, left : left + 52].sum(axis=0).max()) for left in range(12, 12 + 4 * 52, 52)]
    assert heights[3] == pytest.approx(72, abs=1)
    np.testing.assert_allclose(heights, np.array(counts) / 20 * 72, atol=2)  # an empty bar is one line high


def test_letters_of_many_scripts_are_drawn_and_none_stands_for_another() -> None:
    words = "Größe", "Ωμέγα", "Кириллица", "עברית", "a→b ½", "naı̈f"
    pictures = [draw(Page((word,)), WINDOW)[..., 0] for word in words]
    boxes = draw(Page(("\U0010ffff" * 5,)), WINDOW)[..., 0]
    assert all(picture.any() for picture in [*pictures, boxes])
    assert len({picture.tobytes() for picture in [*pictures, boxes]}) == len(words) + 1
    assert plain("a\x1b[2Jb\tc") == "a?[2Jb\tc"


def test_letters_that_only_the_system_has_are_asked_of_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    script = tmp_path / "fc-match"
    script.write_text(f"#!/bin/sh\necho $2 >> {tmp_path}/asked\nprintf %s /no/such.ttf\n")
    script.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    letters._font_of.cache_clear()
    letters._system_font.cache_clear()
    draw(Page(("Grüße 映画",)), WINDOW)
    assert (tmp_path / "asked").read_text().splitlines() == [":charset=6640", ":charset=7540"]
    letters._font_of.cache_clear()
    letters._system_font.cache_clear()


@pytest.mark.parametrize("window", [(720, 1280), (1080, 1920), (384, 512), (216, 384), (150, 200)])
def test_every_key_is_read_on_some_page_of_any_window(window: tuple[int, int]) -> None:
    names = "abcdefghijklmnopqrstuvwxyz0123456789"
    cells = [f"{key}\twhat the key {key} does, in a line of some length" for key in names]
    found = pages(tuple(cells), window)
    said = [cell for page in found for line in page.lines for cell in line.split("\t")]
    assert sorted(name for name in said if len(name) == 1) == sorted(names)
    assert " ".join(" ".join(said).split()).count("what the key") == len(cells)
    for page in found:
        pixels = draw(page, window)
        assert np.all(np.array(inked(pixels)) < np.array(pixels.shape[:2]) - 2)  # no text is cut off


def test_a_legend_shows_its_colours_beside_their_meaning() -> None:
    legends = tuple(Legend(colour, "a word") for colour in ((59, 76, 192), (180, 4, 38)))
    pixels = draw(Page((), legends=legends), WINDOW)
    rows = [np.flatnonzero((pixels[..., :3] == legend.colour).all(axis=-1).any(axis=1)) for legend in legends]
    assert rows[0].max() < rows[1].min()
    assert draw(Page((), legends=legends[:1]), WINDOW).shape[0] < pixels.shape[0]


def test_a_message_stays_a_second_and_is_gone_after_its_fading() -> None:
    now = [0.0]
    message = Message(lambda: now[0])
    assert message.text == ""
    message.say("a")
    seen = []
    for now[0] in (0.0, 0.99, 1.15, 1.31):
        seen.append((message.text, message.opacity))
    assert seen == [("a", 1.0), ("a", 1.0), ("a", 0.5), ("", 0.0)]
    message.say("b", 5)
    now[0] += 4.9
    assert message.opacity == 1
