"""Text over the picture: messages that fade, the statistics page with its histogram, help pages, and legends.

Pages are data. `draw` turns them into pixels, which the window shows at its upper left.
"""

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from counterlight.overlay.letters import plain, width, write
from counterlight.overlay.outline import Outline

SHOWN_S, FADING_S = 1.0, 0.3
MOST_LETTERS = 1000  # longest message; drawing this takes 5 ms.
FEWEST_LETTERS = 12  # fewest letters of a meaning per line, in any window
MESSAGE_SIZE = 1.6
LINE_HEIGHT, BASELINE, MARGIN, TAB_GAP, SWATCH = 24, 16, 12, 18, 14  # pixels in a window of REFERENCE_HEIGHT
REFERENCE_HEIGHT, SMALLEST_SCALE, LARGEST_SCALE = 720, 0.6, 4.0
BAR_WIDTH, BARS_HEIGHT = 52, 72
GROUND_ALPHA = 0.7


@dataclass(frozen=True)
class Histogram:
    """Counts of frames, and the label of each bar."""

    counts: tuple[int, ...]
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Legend:
    """The meaning of a colour in the view.

    colour : 8-bit sRGB.
    """

    colour: tuple[int, int, int]
    text: str


@dataclass(frozen=True)
class Page:
    """Lines of text with tab-separated columns, and below them a histogram or legends.

    opacity : opacity of the whole page, 0..1.
    size : size of the letters; 1 for pages to read, larger for short messages.
    outline : drawn over the picture, below the text.
    """

    lines: tuple[str, ...]
    histogram: Histogram | None = None
    opacity: float = 1.0
    size: float = 1.0
    outline: Outline | None = None
    legends: tuple[Legend, ...] = ()


class Message:
    """One line that stays for a while and then fades."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock, self._text, self._until = clock, "", float("-inf")

    def say(self, text: str, seconds: float = SHOWN_S) -> None:
        self._text, self._until = text[:MOST_LETTERS], self._clock() + seconds

    @property
    def text(self) -> str:
        return self._text if self.opacity else ""

    @property
    def opacity(self) -> float:
        """1 while the message is shown, then falling to 0 in steps of 1/16."""
        left = (self._until - self._clock()) / FADING_S + 1
        return round(min(max(left, 0.0), 1.0) * 16) / 16


def scale_for(window: tuple[int, int]) -> float:
    """Return the scale of text in a window of (height, width)."""
    return min(max(window[0] / REFERENCE_HEIGHT, SMALLEST_SCALE), LARGEST_SCALE)


def draw(page: Page, window: tuple[int, int]) -> NDArray[np.uint8]:
    """Draw white text on a dark, half transparent ground: (height, width, RGBA), at most the window's (height, width).

    A page that is too large is drawn smaller, down to SMALLEST_SCALE. Lines that are still too wide are wrapped, and
    surplus lines are cut off.
    """
    page = replace(page, lines=_fitting(page.lines, window[1]))
    scale = page.size * scale_for(window)
    high, wide = _extent(page, scale)
    fitting = min(1.0, window[0] / high, window[1] / wide)
    if fitting < 1:
        scale = max(scale * fitting, SMALLEST_SCALE)
        high, wide = _extent(page, scale)
    high, wide = max(1, min(high, window[0])), max(1, min(wide, window[1]))
    ink = Image.new("L", (wide, high))
    brush = ImageDraw.Draw(ink)
    columns = _columns(page.lines, scale)
    for row, line in enumerate(page.lines):
        for left, cell in zip(columns, plain(line).split("\t"), strict=False):
            write(brush, (left, scale * _baseline(row)), cell, scale, 255)
    if page.histogram is not None:
        _draw_bars(brush, page.histogram, scale, scale * (MARGIN + LINE_HEIGHT * len(page.lines)))
    for row, legend in enumerate(page.legends, len(page.lines)):
        write(brush, (scale * (MARGIN + LINE_HEIGHT), scale * _baseline(row)), plain(legend.text), scale, 255)
    written = np.asarray(ink)
    alpha = page.opacity * np.maximum(written / 255, GROUND_ALPHA) * 255
    pixels = np.dstack([written, written, written, alpha.round().astype(np.uint8)])
    for row, legend in enumerate(page.legends, len(page.lines)):
        top, left = (round(scale * at) for at in (_baseline(row) - SWATCH + 1, MARGIN))
        pixels[top : top + round(scale * SWATCH), left : left + round(scale * SWATCH)] = (*legend.colour, 255)
    return pixels


@lru_cache(maxsize=4)  # caches the help pages while they are shown
def pages(cells: tuple[str, ...], window: tuple[int, int]) -> tuple[Page, ...]:
    """Arrange cells, each a name, a tab and a meaning, on as few readable pages as possible.

    The cells stand in as many columns as fit, up to three. If even one column is too wide, meanings are wrapped.
    """
    extents = {count: _extent(Page(_in_columns(cells, count)), SMALLEST_SCALE) for count in (1, 2, 3)}
    narrow = [count for count, (_, wide) in extents.items() if wide <= window[1]]
    whole = [count for count in narrow if extents[count][0] <= window[0]]
    if whole:
        largest = max(whole, key=lambda count: min(window[0] / extents[count][0], window[1] / extents[count][1]))
        return (Page(_in_columns(cells, largest)),)
    lines = _in_columns(cells, narrow[-1]) if narrow else _broken(cells, window[1])
    rows = max(int((window[0] / SMALLEST_SCALE - 2 * MARGIN) // LINE_HEIGHT) - 1, 1)
    parts = [lines[first : first + rows] for first in range(0, len(lines), rows)]
    return tuple(Page((*part, f"{number} of {len(parts)}; ? goes on")) for number, part in enumerate(parts, 1))


def _in_columns(cells: Sequence[str], columns: int) -> tuple[str, ...]:
    """Arrange cells in columns, read downwards."""
    rows = max(-(-len(cells) // columns), 1)
    return tuple("\t".join(cells[row::rows]) for row in range(rows))


def _broken(cells: Sequence[str], most: int) -> tuple[str, ...]:
    """Wrap the meanings of cells, so that each line is at most `most` pixels wide."""
    names = max(width(cell.partition("\t")[0], SMALLEST_SCALE) for cell in cells)
    room = most - names - SMALLEST_SCALE * (2 * MARGIN + TAB_GAP)
    letters = max(int(room / width("n", SMALLEST_SCALE)), FEWEST_LETTERS)
    lines = []
    for cell in cells:
        name, _, meaning = cell.partition("\t")
        first, *rest = textwrap.wrap(meaning, letters) or [""]
        lines += [f"{name}\t{first}", *(f"\t{part}" for part in rest)]
    return tuple(lines)


def _fitting(lines: tuple[str, ...], most: int) -> tuple[str, ...]:
    """Wrap the last cells of lines that are wider than `most` pixels."""
    columns, fitting = _columns(lines, SMALLEST_SCALE), []
    for line in lines:
        *before, last = plain(line).split("\t")
        left = columns[min(len(before), len(columns) - 1)]
        room = most - left - MARGIN * SMALLEST_SCALE
        if width(last, SMALLEST_SCALE) <= room:
            fitting.append(line)
            continue
        letters = max(int(room / width("n", SMALLEST_SCALE)), FEWEST_LETTERS)
        first, *rest = textwrap.wrap(last, letters) or [""]
        fitting += ["\t".join((*before, first)), *("\t" * len(before) + part for part in rest)]
    return tuple(fitting)


def _baseline(row: int) -> int:
    return MARGIN + LINE_HEIGHT * row + BASELINE


def _extent(page: Page, scale: float) -> tuple[int, int]:
    """Return the (height, width) of a page."""
    columns = _columns(page.lines, scale)
    right = max((_right(line, columns, scale) for line in page.lines), default=0.0)
    high = LINE_HEIGHT * (len(page.lines) + len(page.legends)) + 2 * MARGIN
    if page.histogram is not None:
        high += BARS_HEIGHT + 2 * LINE_HEIGHT
        right = max(right, scale * (MARGIN + BAR_WIDTH * len(page.histogram.counts)))
    for legend in page.legends:
        right = max(right, scale * (MARGIN + LINE_HEIGHT) + width(plain(legend.text), scale))
    return round(high * scale), round(right + MARGIN * scale)


def _columns(lines: tuple[str, ...], scale: float) -> list[float]:
    """Return the left edge of each column, after the widest cell before it. Lines without tabs do not count."""
    rows = [cells for line in lines if len(cells := plain(line).split("\t")) > 1]
    columns = [MARGIN * scale]
    for index in range(max(map(len, rows), default=1) - 1):
        widest = max(width(cells[index], scale) for cells in rows if len(cells) > index)
        columns.append(columns[-1] + widest + TAB_GAP * scale)
    return columns


def _right(line: str, columns: list[float], scale: float) -> float:
    cells = plain(line).split("\t")
    return columns[len(cells) - 1] + width(cells[-1], scale)


def _draw_bars(brush: ImageDraw.ImageDraw, histogram: Histogram, scale: float, top: float) -> None:
    """Draw bars on a common ground line, with the count above and the label below each bar."""
    most = max(*histogram.counts, 1)
    ground = top + scale * (LINE_HEIGHT + BARS_HEIGHT)
    for index, (count, label) in enumerate(zip(histogram.counts, histogram.labels, strict=True)):
        left = scale * (MARGIN + BAR_WIDTH * index)
        right = left + scale * (BAR_WIDTH - 6)
        brush.rectangle((left, ground - scale * max(BARS_HEIGHT * count / most, 1), right, ground), fill=200)
        middle = (left + right) / 2
        above = ground - scale * BARS_HEIGHT * count / most - 2
        write(brush, (middle, above), str(count), 0.75 * scale, 255, anchor="mb")
        write(brush, (middle, ground + 4), plain(label), 0.75 * scale, 255, anchor="mt")


@dataclass(frozen=True)
class Pointer:
    """A mouse event at (x, y), in shares of the shown picture from its upper left. It may lie outside the picture."""

    action: Literal["press", "move", "release"]
    x: float
    y: float
