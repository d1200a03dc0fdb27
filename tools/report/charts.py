"""Histograms and curves as SVG inside the page, in the page's light or dark colours."""

from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 460, 200
LEFT, BOTTOM, TOP = 46, 40, 14
BINS = 24


def bins_of(values: NDArray[np.integer]) -> list[tuple[int, int, int]]:
    """Returns (lowest, highest, count) of up to 24 integer bins whose widths grow by a fixed ratio."""
    if values.size == 0:
        return []
    low, high = max(int(values.min()), 1), max(int(values.max()), 1)
    edges = np.unique(np.geomspace(low, high + 1, BINS + 1).round().astype(np.int64))
    edges[-1] = high + 1
    edges[0] = min(int(values.min()), low)
    counts, _ = np.histogram(values, edges)
    return [(int(a), int(b) - 1, int(n)) for a, b, n in zip(edges[:-1], edges[1:], counts, strict=True)]


def histogram(bins: Sequence[tuple[int, int, int]], across: str) -> str:
    """Draw bars on a square-root scale, so that one large cluster next to a thousand small clusters stays visible."""
    most = max((count for _, _, count in bins), default=1) or 1
    step = (WIDTH - LEFT) / max(len(bins), 1)
    bars, labels = [], []
    for i, (low, high, count) in enumerate(bins):
        height = (HEIGHT - BOTTOM - TOP) * float(np.sqrt(count / most))
        y = HEIGHT - BOTTOM - height
        title = f"{low} to {high}: {count}"
        x = LEFT + i * step
        bars.append(
            f'<rect x="{x:.1f}" y="{y:.1f}" width="{max(step - 2, 1):.1f}" height="{height:.1f}">'
            f"<title>{title}</title></rect>"
        )
        if i % max(1, -(-len(bins) // 8)) == 0:
            labels.append(_text(x, HEIGHT - BOTTOM + 14, str(low)))
    return _svg([*bars, *labels, *_frame(across, f"{most}")])


def curve(points: Sequence[tuple[float, float]], chosen: float, across: str) -> str:
    """Draw values from 0 up over a logarithmic axis; the chosen value is marked."""
    x = np.log10([a for a, _ in points])
    most = max(b for _, b in points) or 1.0
    across_px = LEFT + 16 + (x - x.min()) / max(float(np.ptp(x)), 1e-9) * (WIDTH - LEFT - 46)
    up_px = [HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * b / most for _, b in points]
    line = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across_px, up_px, strict=True))
    parts = [f'<polyline points="{line}"/>']
    for (value, error), a, b in zip(points, across_px, up_px, strict=True):
        kind = ' class="chosen"' if value == chosen else ""
        parts.append(
            f'<circle{kind} cx="{a:.1f}" cy="{b:.1f}" r="{6 if kind else 3.5}">'
            f"<title>{value:g}: {error:.4g}</title></circle>"
        )
        parts.append(_text(a - 10, HEIGHT - BOTTOM + 14, f"{value:g}"))
    return _svg([*parts, *_frame(across, f"{most:.3g}")])


def rising(columns: Sequence[Sequence[float]], colours: Sequence[str], across: str) -> str:
    """Draw curves from 0 to 1 over equal steps, one per colour."""
    lines = []
    for values, colour in zip(columns, colours, strict=True):
        steps = np.linspace(LEFT, WIDTH - 16, len(values))
        up = HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * np.asarray(values)
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(steps, up, strict=True))
        lines.append(f'<polyline style="stroke: {colour}" points="{points}"/>')
    return _svg([*lines, *_frame(across, "1")])


def _frame(across: str, top: str) -> list[str]:
    base = HEIGHT - BOTTOM
    return [
        f'<line x1="{LEFT}" y1="{base}" x2="{WIDTH}" y2="{base}"/>',
        _text(2, TOP + 4, top),
        _text(2, base, "0"),
        _text(LEFT, HEIGHT - 8, across),
    ]


def _text(x: float, y: float, words: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}">{escape(words)}</text>'


def _svg(parts: Sequence[str]) -> str:
    return f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img">{"".join(parts)}</svg>'
