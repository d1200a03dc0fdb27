"""The means over all rooms and pictures as two Markdown tables, for docs/accuracy.md."""

from collections.abc import Sequence

import numpy as np

from counterlight.tools.study.recommend import Wish
from counterlight.tools.study.results import Mean, Row

HEADER = (
    "| method | dB below the best | worst room | RMSE, % of white | SSIM | CIEDE2000 | clipped, % | ms a picture "
    "| MiB of maps | preparation, s |\n|---|---|---|---|---|---|---|---|---|---|\n"
)


def to_markdown(rows: Sequence[Row], averages: Sequence[Mean], advice: Sequence[Wish]) -> str:
    """Returns a line per method that was used in every room, and a line per wish.

    averages : means of those methods.
    """
    methods = "".join(_line(point, [row for row in rows if row.label == point.label]) for point in averages)
    wishes = "".join(
        f"| {wish.words} | `{wish.method.command if wish.method else 'none'}` | {wish.why} |\n" for wish in advice
    )
    return f"{HEADER}{methods}\n| you want | options | here |\n|---|---|---|\n{wishes}"


def _line(point: Mean, rows: Sequence[Row]) -> str:
    rmse, ssim, clipped = (np.mean([getattr(row, name) for row in rows]) for name in ("rmse", "ssim", "clipped"))
    costs = " | ".join(_short(value) for value in (point.picture_ms, point.map_mib, point.preparation_s))
    return (
        f"| {point.label}{'' if point.played else ' (solver)'} | {point.below_optimum_db:.2f} | {point.worst_db:.2f} "
        f"| {100 * rmse:.2f} | {ssim:.3f} | {point.ciede2000:.2f} | {100 * clipped:.1f} | {costs} |\n"
    )


def _short(value: float | None) -> str:
    return "–" if not value else f"{value:.2g}" if value < 100 else f"{value:.0f}"
