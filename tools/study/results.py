"""The figures of a study: a row per room, picture and method; their means, their Pareto front; CSV and JSON."""

import csv
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from counterlight.unattended.json_lines import finite

FORMAT = 1
UNSEEN_DB = 0.01


@dataclass(frozen=True)
class Row:
    """One picture by one method in one room; None where a figure does not exist.

    rmse, psnr_db, ssim, ciede2000 : defined in tools/solve/quality.py.
    clipped : share of the projector's lit values.
    below_optimum_db : decibels of PSNR below the box optimum.
    certified_db : upper bound of below_optimum_db, from the gradient.
    bound_codes : certified change of a drive by truncation or rounding, in 8-bit code values of linear drive.
    preparation_s : processor seconds to prepare the room.
    cpu_s : processor seconds of a solver for the picture.
    frame_ms : time per frame in the player; wall-clock time on a GPU, processor time in software.
    map_mib : size of all maps that a frame reads.
    """

    room: str
    picture: str
    family: str
    knob: str
    value: float | None
    command: str
    rmse: float
    psnr_db: float
    ssim: float
    ciede2000: float
    clipped: float
    below_optimum_db: float
    certified_db: float | None
    bound_codes: float | None
    preparation_s: float
    cpu_s: float | None
    frame_ms: float | None
    map_mib: float | None

    @property
    def label(self) -> str:
        return label(self.family, self.knob, self.value)

    @property
    def picture_ms(self) -> float | None:
        """Milliseconds of a frame in the player, or of a solver's picture."""
        return self.frame_ms if self.frame_ms is not None else None if self.cpu_s is None else 1000 * self.cpu_s


@dataclass(frozen=True)
class Skipped:
    """Method that was skipped for this room, with the reason."""

    room: str
    method: str
    reason: str


@dataclass(frozen=True)
class Mean:
    """A method averaged over pictures and rooms: decibels and CIEDE2000 arithmetically, costs geometrically.

    worst_db : the highest mean of a room.
    rooms : number of rooms in which the method was used.
    """

    label: str
    family: str
    knob: str
    value: float | None
    command: str
    below_optimum_db: float
    worst_db: float
    ciede2000: float
    preparation_s: float
    picture_ms: float | None
    map_mib: float | None
    played: bool
    rooms: int


def label(family: str, knob: str, value: float | None) -> str:
    return family if value is None else f"{family}, {knob} {value:g}"


def means(rows: Iterable[Row]) -> list[Mean]:
    """Returns one Mean per method, in the order of the rows."""
    grouped: dict[str, list[Row]] = {}
    for row in rows:
        grouped.setdefault(row.label, []).append(row)
    return [_mean(name, group) for name, group in grouped.items()]


def everywhere(rows: Sequence[Row]) -> list[Mean]:
    """Returns the means of the methods that were used in every room, which are comparable."""
    rooms = len({row.room for row in rows})
    return [point for point in means(rows) if point.rooms == rooms]


def _mean(name: str, rows: list[Row]) -> Mean:
    first = rows[0]
    rooms = {row.room for row in rows}
    by_room = [np.mean([row.below_optimum_db for row in rows if row.room == room]) for room in rooms]
    return Mean(
        name,
        first.family,
        first.knob,
        first.value,
        first.command,
        float(np.mean(by_room)),
        float(np.max(by_room)),
        float(np.mean([row.ciede2000 for row in rows])),
        geometric([row.preparation_s for row in rows]) or 0.0,
        geometric([row.picture_ms for row in rows]),
        geometric([row.map_mib for row in rows]),
        first.frame_ms is not None,
        len(rooms),
    )


def geometric(values: Sequence[float | None]) -> float | None:
    """Returns the geometric mean of the known positive values: doubling in one room and halving in another cancel."""
    known = [value for value in values if value is not None and value > 0]
    return float(np.exp(np.mean(np.log(known)))) if known else None


def pareto(points: Sequence[Mean], cost: Callable[[Mean], float | None]) -> list[Mean]:
    """Returns the points that no other point beats in both cost and decibels, cheapest first.

    Differences below UNSEEN_DB count as equal.
    """
    front: list[Mean] = []
    priced = [(price, visible_db(point), point) for point in points if (price := cost(point)) is not None]
    for _, error, point in sorted(priced, key=lambda triple: triple[:2]):
        if not front or error < visible_db(front[-1]):
            front.append(point)
    return front


def visible_db(point: Mean) -> float:
    """Returns the decibels below the optimum, at least UNSEEN_DB."""
    return max(point.below_optimum_db, UNSEEN_DB)


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Row)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def write_json(path: Path, facts: dict[str, Any], rows: Sequence[Row], skipped: Sequence[Skipped]) -> None:
    table = {"format": FORMAT, **facts, "rows": list(map(asdict, rows)), "skipped": list(map(asdict, skipped))}
    path.write_text(json.dumps(finite(table), indent=1, allow_nan=False) + "\n", encoding="utf-8")
