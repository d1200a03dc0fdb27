"""The plots of a study as PNG (matplotlib's Agg, no screen): error against time, map size and every knob."""

import math
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator
from numpy.typing import NDArray

from counterlight.tools.study.recommend import FRAME_MS
from counterlight.tools.study.results import UNSEEN_DB, Mean, Row, everywhere, means, pareto, visible_db
from counterlight.tools.study.tables import number

Cost = Callable[[Mean], float | None]
STYLES = {  # colour, marker
    "uncompensated": ("#888888", "X"),
    "direct": ("#8c564b", "P"),
    "T⁺ plain": ("#d62728", "v"),
    "T⁺ of the thesis": ("#d62728", "s"),
    "T⁺, cut": ("#ff7f0e", "s"),
    "T⁺": ("#1f77b4", "o"),
    "T⁺, λ given": ("#17becf", "d"),
    "refined from direct": ("#9467bd", "<"),
    "refined from T⁺, cut": ("#bcbd22", ">"),
    "refined from T⁺": ("#2ca02c", "^"),
    "NNLS": ("#000000", "D"),
    "box optimum": ("#000000", "h"),
}
OTHER = ("#e377c2", "p")
FAINT = "#777777"
KNOBS = {
    "max-error": ("--max-error, 8-bit code values", "truncation"),
    "max-cluster": ("--max-cluster, projector pixels", "largest cluster"),
    "regularize": ("--regularize, λ / σ₁", "damping"),
    "steps": ("--refine, steps a frame", "refinement"),
}
DPI = 110
LABEL = 26, 12  # pixels that a label covers


def draw_all(folder: Path, rows: Sequence[Row], time_note: str) -> dict[str, str]:
    """Write every plot; returns file names by content."""
    averages = everywhere(rows)
    files = {
        "time": save(
            folder / "error_time.png",
            _overview(averages, _picture_ms, f"milliseconds a picture ({time_note})", vertical=FRAME_MS),
        ),
        "preparation": save(
            folder / "error_preparation.png",
            _overview([m for m in averages if m.played], _preparation, "seconds to prepare a room, of processor time"),
        ),
        "size": save(
            folder / "error_size.png",
            _overview([m for m in averages if m.map_mib], lambda m: m.map_mib, "MiB of maps that a frame reads"),
        ),
        "knobs": save(folder / "error_knobs.png", _knobs(rows)),
    }
    rooms = list(dict.fromkeys(row.room for row in rows))
    if len(rooms) > 1:
        files["rooms"] = save(folder / "error_rooms.png", _by_room(rooms, rows, time_note))
    return files


def _picture_ms(point: Mean) -> float | None:
    return point.picture_ms


def _preparation(point: Mean) -> float | None:
    return point.preparation_s or None


def _overview(points: Sequence[Mean], cost: Cost, across: str, vertical: float | None = None) -> Figure:
    figure, axes = plt.subplots(figsize=(10, 6.2), layout="constrained")
    _scatter(axes, points, cost)
    if vertical is not None:
        axes.axvline(vertical, color=FAINT, linewidth=0.8, linestyle=":")
        above = ("data", "axes fraction")
        axes.annotate("60 a second", (vertical, 1), (3, -12), above, "offset points", fontsize=8, color=FAINT)
    axes.set_xlabel(across)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside right upper", fontsize=8, frameon=False)
    return figure


def _scatter(axes: Axes, points: Sequence[Mean], cost: Cost, *, small: bool = False) -> None:
    """Draw methods as marks, families as thin lines, the Pareto front as a staircase; hollow marks are solvers."""
    for family in dict.fromkeys(point.family for point in points):
        colour, marker = STYLES.get(family, OTHER)
        members = _by_value([point for point in points if point.family == family])
        x, y = _places(members, cost)
        if not x:
            continue
        played = members[0].played
        axes.plot(x, y, color=colour, linewidth=0.7, alpha=0.5)
        words, face = (family, colour) if played else (f"{family} (solver)", "none")
        axes.scatter(x, y, 22 if small else 45, marker=marker, facecolor=face, edgecolor=colour, label=words, zorder=3)
    front = pareto([point for point in points if point.played], cost)
    x, y = _places(front, cost)
    axes.step(x, y, where="post", color="#000000", linewidth=1.2, alpha=0.6, zorder=2, label="Pareto front (player)")
    cost_axis(axes)
    decibel_axis(axes)
    if not small:
        _label(axes, [(point.value, place) for point, place in zip(front, zip(x, y, strict=True), strict=True)])


def _label(axes: Axes, values: Sequence[tuple[float | None, tuple[float, float]]]) -> None:
    """Write values next to their points, except where a label would cover another label."""
    written: list[NDArray[Any]] = []
    for value, place in values:
        at = axes.transData.transform(place)
        if value is not None and all((abs(at - other) > LABEL).any() for other in written):
            axes.annotate(f"{value:g}", place, (4, 5), "data", "offset points", fontsize=8)
            written.append(at)


def _by_value(points: Sequence[Mean]) -> list[Mean]:
    return sorted(points, key=lambda point: point.value or 0.0)


def _places(points: Sequence[Mean], cost: Cost) -> tuple[list[float], list[float]]:
    """Returns the coordinates of the points that have a cost."""
    priced = [(price, visible_db(point)) for point in points if (price := cost(point)) is not None]
    return [x for x, _ in priced], [y for _, y in priced]


def cost_axis(axes: Axes) -> None:
    """Make the cost axis logarithmic, with plain numbers; call after drawing."""
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    decades = math.log10(high / low)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if decades < 2 else (1, 3) if decades < 4 else (1,)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: number(float(value))))


def decibel_axis(axes: Axes) -> None:
    """Make the axis of decibels below the best logarithmic, from the invisible difference UNSEEN_DB."""
    axes.set_yscale("log")
    axes.set_ylim(UNSEEN_DB * 0.8, None)
    axes.set_yticks([0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30], ["≤ 0.01", "0.03", "0.1", "0.3", "1", "3", "10", "30"])
    axes.minorticks_off()
    axes.set_ylabel("dB below the best possible picture")
    axes.grid(alpha=0.25)


def _by_room(rooms: Sequence[str], rows: Sequence[Row], time_note: str) -> Figure:
    columns = min(3, len(rooms))
    lines = -(-len(rooms) // columns)
    figure, grid = plt.subplots(
        lines, columns, figsize=(4.3 * columns, 3.6 * lines), layout="constrained", squeeze=False, sharey=True
    )
    for axes, room in zip(grid.flat, rooms, strict=False):
        _scatter(axes, means(row for row in rows if row.room == room), _picture_ms, small=True)
        axes.set_title(room, fontsize=10)
    for axes in grid.flat[len(rooms) :]:
        axes.set_visible(False)
    for axes in grid[:, 1:].flat:
        axes.set_ylabel("")
    figure.supxlabel(f"milliseconds a picture ({time_note})", fontsize=10)
    handles = {
        label: handle for axes in grid.flat for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside right upper", fontsize=8, frameon=False)
    return figure


def _knobs(rows: Sequence[Row]) -> Figure:
    """Draw one plot per knob: each family's mean over the rooms as a thick line, each room as a thin line."""
    present = [knob for knob in KNOBS if any(row.knob == knob for row in rows)]
    figure, grid = plt.subplots(2, 2, figsize=(11, 8), layout="constrained", squeeze=False)
    for axes, knob in zip(grid.flat, present, strict=False):
        turned = [row for row in rows if row.knob == knob]
        for family in dict.fromkeys(row.family for row in turned):
            colour, marker = STYLES.get(family, OTHER)
            members = [row for row in turned if row.family == family]
            for room in dict.fromkeys(row.room for row in members):
                points = _by_value(means(row for row in members if row.room == room))
                axes.plot(*_places(points, _value), color=colour, linewidth=0.7, alpha=0.35)
            axes.plot(
                *_places(_by_value(_where_all(members)), _value), color=colour, linewidth=2, marker=marker, label=family
            )
        cost_axis(axes)
        decibel_axis(axes)
        axes.set_title(KNOBS[knob][1], fontsize=10)
        axes.set_xlabel(KNOBS[knob][0])
        axes.legend(fontsize=8, frameon=False)
    for axes in grid.flat[len(present) :]:
        axes.set_visible(False)
    return figure


def _where_all(rows: Sequence[Row]) -> list[Mean]:
    """Returns the means over the rooms in which every value of a knob was tried."""
    values = {row.value for row in rows}
    rooms = dict.fromkeys(row.room for row in rows)
    complete = [room for room in rooms if values == {row.value for row in rows if row.room == room}]
    return means(row for row in rows if row.room in complete)


def _value(point: Mean) -> float | None:
    return point.value


def subplots(rows: int, columns: int, shape: tuple[int, int]) -> tuple[Figure, NDArray[Any]]:
    """Returns a grid of axes (rows, columns) for pictures of a shape (height, width)."""
    width = 2.3
    height = width * shape[0] / shape[1] + 0.35
    size = columns * width, rows * height
    return plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)


def save(path: Path, figure: Figure) -> str:
    """Write and close a figure; returns the file's name."""
    picture = BytesIO()  # written in one piece, because matplotlib misses write errors of the system
    figure.savefig(picture, dpi=DPI, format="png")
    plt.close(figure)
    path.write_bytes(picture.getvalue())
    return path.name
