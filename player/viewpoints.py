"""Several views of one room, calibrated from different places, and the share of each view for a viewer.

A set of views is a folder with viewpoints.toml and one calibration in each of views/1, views/2, … All views have the
same projectors and one common screen (docs/viewpoints.md). A viewer between views gets a blend of the two or three
surrounding views. The shares are barycentric coordinates in a triangulation of the places.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import InputError
from counterlight.files.manifest import sha256_of, write_toml
from counterlight.files.reading import read_toml
from counterlight.files.tables import Table

FORMAT, TOML, FOLDER = 1, "viewpoints.toml", "views"
MOST_VIEWS, FARTHEST = 64, 1e6
JOIN = "join the views again: counterlight join VIEW… --at X[,Y]… -o FOLDER"
LEAST = 1e-6  # smaller shares count as 0, so that a view is reached exactly
ROUNDING = 1e-9  # tolerance, relative to the places' extent
LIFT = 1e-7  # random lift, relative to the squared extent; decides between equally good triangles

FloatArray = NDArray[np.float64]
Points: TypeAlias = tuple[tuple[float, float], ...]
Viewpoint: TypeAlias = Points | Literal["all"]  # one or several viewers; "all" means one viewer at every view


@dataclass(frozen=True)
class Places:
    """The place of each view, x and y in any unit. Viewers' places use the same unit."""

    at: Points

    def __post_init__(self) -> None:
        if not 1 <= len(self.at) <= MOST_VIEWS:
            raise InputError(f"{len(self.at)} views, expected 1 to {MOST_VIEWS}")
        if not np.all(np.abs(self._at) <= FARTHEST):  # `not`, because a comparison with NaN is false
            raise InputError(f"views at {self.at}: expected numbers from {-FARTHEST:g} to {FARTHEST:g}")
        for one, other in combinations(range(len(self.at)), 2):
            if np.abs(self._at[one] - self._at[other]).max() <= ROUNDING * self._extent:
                raise InputError(f"views {one + 1} and {other + 1} are both at {_written(self.at[one])}; leave one out")

    def shares(self, viewpoint: Viewpoint) -> FloatArray:
        """Return each view's share, (views,), with sum 1. Outside all views, the nearest inner place counts."""
        if viewpoint == "all":
            return np.full(len(self.at), 1 / len(self.at))
        shares = np.mean([self._shares_at(np.array(point)) for point in viewpoint], axis=0)
        shares[shares < LEAST] = 0
        return np.asarray(shares / shares.sum())

    def outside(self, viewpoint: Viewpoint) -> str | None:
        """Return a line about viewers outside all views, None if there are none."""
        for point in () if viewpoint == "all" else viewpoint:
            taken = self._shares_at(np.array(point)) @ self._at
            if np.abs(taken - point).max() > LEAST * self._extent:
                return f"viewpoint {_written(point)} is outside the views; taken as {_written((taken[0], taken[1]))}"
        return None

    @cached_property
    def _at(self) -> FloatArray:
        return np.array(self.at, np.float64).reshape(-1, 2)

    @property
    def _extent(self) -> float:
        return float(np.ptp(self._at, axis=0).max()) or 1.0

    def _shares_at(self, point: FloatArray) -> FloatArray:
        shares = np.zeros(len(self.at))
        corners, inverse = self._triangles
        if len(corners):
            two = np.einsum("tij,tj->ti", inverse, point - self._at[corners[:, 2]])
            each = np.column_stack([two, 1 - two.sum(axis=1)])
            best = int(each.min(axis=1).argmax())
            if each[best].min() >= -ROUNDING:
                shares[corners[best]] = np.clip(each[best], 0, 1)
                return shares
        shares[self._edges[0, 0]] = 1  # a single view has the whole share
        if len(self.at) > 1:
            start, along = self._at[self._edges[:, 0]], np.diff(self._at[self._edges], axis=1)[:, 0]
            t = np.clip(((point - start) * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
            best = int(((start + t[:, None] * along - point) ** 2).sum(axis=1).argmin())
            shares[:] = 0
            shares[self._edges[best]] = 1 - t[best], t[best]
        return shares

    @cached_property
    def _edges(self) -> NDArray[np.int64]:
        """Pairs of views that a viewer can be between, (edges, 2)."""
        corners, _ = self._triangles
        if len(corners):
            return np.unique(np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0)
        order = np.lexsort(self._at.T)  # all places are on a line
        return np.stack([order[:-1], order[1:]], axis=1) if len(order) > 1 else np.zeros((1, 2), np.int64)

    @cached_property
    def _triangles(self) -> tuple[NDArray[np.int64], FloatArray]:
        """Corners, (triangles, 3), and matrices, (triangles, 2, 2), of the triangulation of the places.

        A matrix converts a place relative to the third corner into the shares of the first two corners.

        The triangulation is the lower hull of the places lifted by their squares (Delaunay). A small random lift makes
        it unique if four places lie on a circle.
        """
        at = (self._at - self._at.mean(axis=0)) / self._extent
        lifted = (at**2).sum(axis=1) + LIFT * np.random.default_rng(0).uniform(size=len(at))
        triples = np.array(list(combinations(range(len(at)), 3)), np.int64).reshape(-1, 3)
        sides = at[triples[:, :2]] - at[triples[:, 2:]]
        area = np.linalg.det(sides)
        triples, sides = triples[np.abs(area) > ROUNDING], sides[np.abs(area) > ROUNDING]
        slope = np.linalg.solve(sides, (lifted[triples[:, :2]] - lifted[triples[:, 2:]])[..., None])[..., 0]
        plane = lifted[triples[:, 2]][:, None] + np.einsum("tj,tvj->tv", slope, at - at[triples[:, 2]][:, None])
        above = lifted - plane
        np.put_along_axis(above, triples, np.inf, axis=1)
        lowest = triples[(above > 0).all(axis=1)]
        spans = (self._at[lowest[:, :2]] - self._at[lowest[:, 2:]]).swapaxes(1, 2)
        return lowest, np.linalg.inv(spans)


def is_set(folder: Path) -> bool:
    """Whether a folder holds a set of views."""
    return (folder / TOML).is_file()


def folders_of(folder: Path, count: int) -> list[Path]:
    """Return the folders of a set's views."""
    return [folder / FOLDER / f"{number}" for number in range(1, count + 1)]


def calibrations_in(folder: Path) -> list[Path]:
    """Return the folders of a set's views, or the folder itself if it is a single calibration."""
    if not is_set(folder):
        return [folder]
    table = Table(read_toml(folder / TOML, JOIN), f"{folder / TOML}", JOIN)
    return folders_of(folder, len(table.tables("views", MOST_VIEWS)))


def write_places(folder: Path, places: Places, calibrations: Sequence[Path]) -> None:
    """Write viewpoints.toml of a set whose views already exist.

    folder : folder of the set.
    places : places of the views.
    calibrations : calibration.toml of each view.
    """
    views = [{"at": list(at), "calibration": sha256_of(path)} for at, path in zip(places.at, calibrations, strict=True)]
    write_toml(folder / TOML, {"format": FORMAT, "views": views})


def read_places(folder: Path, calibration: str) -> Places:
    """Read the places of a set's views. Raises InputError for a damaged list, or a view that was recalibrated.

    folder : folder of the set.
    calibration : name of the calibration file in each view's folder.
    """
    table = Table(read_toml(folder / TOML, JOIN), f"{folder / TOML}", JOIN)
    table.format(FORMAT)
    entries = table.tables("views", MOST_VIEWS)
    at = [entry.numbers("at", 2, None, -FARTHEST, FARTHEST) for entry in entries]
    for entry, view in zip(entries, folders_of(folder, len(entries)), strict=True):
        expected = entry.text("calibration")
        if not (view / calibration).is_file():
            raise InputError(f"{view}: no calibration, {folder / TOML} lists {len(entries)}; {JOIN}")
        if sha256_of(view / calibration) != expected:
            raise InputError(f"{view}: another calibration than that which {folder / TOML} lists; {JOIN}")
    try:
        return Places(tuple((float(x), float(y)) for x, y in at))
    except InputError as error:
        raise table.refusal(f", {error}") from None


def _written(point: Sequence[float]) -> str:
    return f"{point[0]:g},{point[1]:g}"
