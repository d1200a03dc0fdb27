"""What is written over the picture: a message that fades, the stats page with its histogram, the help page.

Pages are data; `draw` makes pixels of them, which the window shows at its upper left.
"""

import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from counterlight.overlay.outline import Outline

SHOWN_S, FADING_S = 1.0, 0.3
MOST_LETTERS = 1000  # of a message: drawing them takes 5 ms
MESSAGE_SIZE = 1.6
TEXT_HEIGHT, LINE_HEIGHT, MARGIN, TAB_GAP = 18, 24, 12, 18  # pixels in a window of REFERENCE_HEIGHT
REFERENCE_HEIGHT, SMALLEST_SCALE, LARGEST_SCALE = 720, 0.6, 4.0
BAR_WIDTH, BARS_HEIGHT = 52, 72
GROUND_ALPHA = 0.7


@dataclass(frozen=True)
class Histogram:
    """Counts of frames, and what each bar is called."""

    counts: tuple[int, ...]
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Page:
    """Lines of text, a tab apart in columns, and a histogram below them.

    opacity : 0..1 of all of it.  size : of the letters, 1 for a page that is read, more for a word in passing.
    outline : drawn over the picture, below the text.
    """

    lines: tuple[str, ...]
    histogram: Histogram | None = None
    opacity: float = 1.0
    size: float = 1.0
    outline: Outline | None = None


class Message:
    """One line that stays for a while and fades."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock, self._text, self._until = clock, "", float("-inf")

    def say(self, text: str, seconds: float = SHOWN_S) -> None:
        self._text, self._until = text[:MOST_LETTERS], self._clock() + seconds

    @property
    def text(self) -> str:
        return self._text if self.opacity else ""

    @property
    def opacity(self) -> float:
        """1 while it is shown, then down to 0, in steps that a screen's refresh can follow."""
        left = (self._until - self._clock()) / FADING_S + 1
        return round(min(max(left, 0.0), 1.0) * 16) / 16


def scale_for(window: tuple[int, int]) -> float:
    """How large text is in a window (height, width)."""
    return min(max(window[0] / REFERENCE_HEIGHT, SMALLEST_SCALE), LARGEST_SCALE)


def draw(page: Page, window: tuple[int, int]) -> NDArray[np.uint8]:
    """White text on a dark, half transparent ground: (height, width, RGBA), no larger than the window (height, width).

    A page that is too large for the window is drawn smaller, down to SMALLEST_SCALE, and then cut off.
    """
    scale = page.size * scale_for(window)
    height, width = _extent(page, scale)
    fitting = min(1.0, window[0] / height, window[1] / width)
    if fitting < 1:
        scale = max(scale * fitting, SMALLEST_SCALE)
        height, width = _extent(page, scale)
    height, width = max(1, min(height, window[0])), max(1, min(width, window[1]))
    ink = Image.new("L", (width, height))
    brush = ImageDraw.Draw(ink)
    columns = _columns(page.lines, scale)
    for row, line in enumerate(page.lines):
        top = MARGIN + LINE_HEIGHT * row
        for left, cell in zip(columns, plain(line).split("\t"), strict=False):
            brush.text((left, top * scale), cell, fill=255, font=_font(scale))
    if page.histogram is not None:
        _draw_bars(brush, page.histogram, scale, scale * (MARGIN + LINE_HEIGHT * len(page.lines)))
    written = np.asarray(ink)
    alpha = page.opacity * np.maximum(written / 255, GROUND_ALPHA) * 255
    return np.dstack([written, written, written, alpha.round().astype(np.uint8)])


def plain(text: str) -> str:
    """Text in the letters that the font has: accents are taken off, other scripts become question marks."""
    bare = "".join(letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))
    return "".join(letter if letter == "\t" or " " <= letter <= "~" else "?" for letter in bare)


def _extent(page: Page, scale: float) -> tuple[int, int]:
    """(height, width) of a page."""
    columns = _columns(page.lines, scale)
    width = max((_right(line, columns, scale) for line in page.lines), default=0.0)
    height = LINE_HEIGHT * len(page.lines) + 2 * MARGIN
    if page.histogram is not None:
        height += BARS_HEIGHT + 2 * LINE_HEIGHT
        width = max(width, scale * (MARGIN + BAR_WIDTH * len(page.histogram.counts)))
    return round(height * scale), round(width + MARGIN * scale)


def _columns(lines: tuple[str, ...], scale: float) -> list[float]:
    """Where each column begins: after the widest cell of the one before, in the lines that have more than one."""
    rows = [cells for line in lines if len(cells := plain(line).split("\t")) > 1]
    columns = [MARGIN * scale]
    for index in range(max(map(len, rows), default=1) - 1):
        widest = max(_font(scale).getlength(cells[index]) for cells in rows if len(cells) > index)
        columns.append(columns[-1] + widest + TAB_GAP * scale)
    return columns


def _right(line: str, columns: list[float], scale: float) -> float:
    cells = plain(line).split("\t")
    return columns[len(cells) - 1] + float(_font(scale).getlength(cells[-1]))


def _draw_bars(brush: ImageDraw.ImageDraw, histogram: Histogram, scale: float, top: float) -> None:
    """Bars from a common ground, the count above and the label below each."""
    most = max(*histogram.counts, 1)
    ground = top + scale * (LINE_HEIGHT + BARS_HEIGHT)
    small = _font(0.75 * scale)
    for index, (count, label) in enumerate(zip(histogram.counts, histogram.labels, strict=True)):
        left = scale * (MARGIN + BAR_WIDTH * index)
        right = left + scale * (BAR_WIDTH - 6)
        brush.rectangle((left, ground - scale * max(BARS_HEIGHT * count / most, 1), right, ground), fill=200)
        middle = (left + right) / 2
        above = ground - scale * BARS_HEIGHT * count / most - 2
        brush.text((middle, above), str(count), fill=255, font=small, anchor="mb")
        brush.text((middle, ground + 4), plain(label), fill=255, font=small, anchor="mt")


@lru_cache(maxsize=16)
def _font(scale: float) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(TEXT_HEIGHT * scale)
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font
