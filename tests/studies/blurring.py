"""Cost of blocks of pixels for films, in `two_planes` at 1920x1080: python -m tests.studies.blurring

The square of widest blur on the far card is simulated whole, twice, with different sample points of the lens. T is put
into blocks with a series of limits. Each row states entries per camera pixel, and the dB that pictures lose: the
pictures of `--tolerance`, and windows of a film at its size. The row "another T" shows the effect of sampling: the
loss of drives by another T of the same room. In the second table, this other T, with other samples, judges T and its
blocks. The study takes five minutes of processor time.
"""

from itertools import islice
from unittest.mock import patch

import numpy as np

from counterlight.arrays import FloatArray, IntArray
from counterlight.maps.row_map import SparseRows, below_each_other
from counterlight.tools.blurring import blurring
from counterlight.tools.blurring.pruning import Pyramid, in_cells
from counterlight.tools.inverse.pictures import soft_picture, typical_pictures
from counterlight.tools.shipped import parse_scene
from counterlight.tools.simulation import bands
from counterlight.tools.simulation.effects_on import EffectsOn
from counterlight.tools.simulation.lens import LensPoints
from counterlight.tools.simulation.needs import needs_of
from counterlight.tools.simulation.paths import Rays
from counterlight.tools.simulation.scene import Scene, load_scene
from counterlight.tools.simulation.simulate import _Simulation
from counterlight.tools.study.pictures import find_pictures
from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import Transport

SIZE, TOP, BAND, SAMPLED = (1080, 1920), 152, 8, 32
WINDOWS = (100, 200), (460, 880), (800, 1500)  # upper left corners of the windows in a film of that size
LIMITS = blurring.LIMITS[7:11]
OTHER_POINTS = 7 * SIZE[0] * SIZE[1]  # added to a pixel's number, from which its points of the lens follow


def pictures(side: tuple[int, int]) -> dict[str, FloatArray]:
    """Returns pictures by name, (height, width)."""
    film = find_pictures(["film"])[0].at(SIZE).mean(axis=2)
    noise, letters, _ = typical_pictures(side)
    judging = {"photograph": noise, "letters": letters, "soft": soft_picture(side)}
    return judging | {f"film {top},{left}": film[top : top + side[0], left : left + side[1]] for top, left in WINDOWS}


def rows_of(lines: range, columns: range, sampling: int) -> SparseRows:
    """Returns T of some camera pixels.

    sampling : number of a set of lens points.
    """
    scene = load_scene(parse_scene("two_planes")).resized(SIZE, SIZE)
    simulation = _Simulation(scene, needs_of(scene))
    simulation.prepare()
    all_rays, all_points = bands.primary_rays, LensPoints.of

    def some_rays(scene: Scene, rows: range, effects: EffectsOn) -> Rays:
        rays = all_rays(scene, rows, effects)
        column = rays.pixel % SIZE[1]
        return rays.at((column >= columns.start) & (column < columns.stop))

    def points(lens: LensPoints, pixels: IntArray, count: int) -> tuple[FloatArray, FloatArray]:
        return all_points(lens, pixels + sampling * OTHER_POINTS, count)

    with patch.object(bands, "primary_rays", some_rays), patch.object(LensPoints, "of", points):
        parts = []
        for top in range(lines.start, lines.stop, BAND):
            band = range(top, min(top + BAND, lines.stop))
            own = np.arange(len(band))[:, None] * SIZE[1] + np.array(columns)
            parts.append(simulation.band(band).near.at(own.ravel()))
        return below_each_other(parts)


def widest() -> range:
    """Returns the columns of the square with the widest blur, which is estimated from some lines."""
    lines = [rows_of(range(y, y + 1), range(SIZE[1]), 0).lengths for y in range(TOP, TOP + blurring.SIDE, SAMPLED)]
    sums = np.concatenate([[0], np.cumsum(np.sum(lines, axis=0))])
    left = int((sums[blurring.SIDE :] - sums[: -blurring.SIDE]).argmax())
    return range(left, left + blurring.SIDE)


class Judges:
    """One room's T twice, with different points of the lens: losses of pictures below the best by either T."""

    def __init__(self, square: blurring._Square, other: SparseRows) -> None:
        self._square, self._T = square, [square._T, square._objective(Transport(other))]
        self._best = [self._errors(T)[number] for number, T in enumerate(self._T)]

    def losses(self, made: Transport) -> list[list[float]]:
        """Returns dB lost by each picture with drives of `made`, judged by the first T and by the second."""
        found = self._errors(self._square._objective(made))
        return [
            [10 * float(np.log10(error / least)) for error, least in zip(*pair, strict=True)]
            for pair in zip(found, self._best, strict=True)
        ]

    def _errors(self, by: Objective) -> list[list[float]]:
        """Returns the errors by both T of the drives for one T."""
        grey = np.full((self._square._columns.size, 3), 0.5)
        drives = [next(islice(by.steps(grey, b), blurring.STEPS, None)) for b in self._square._asked]
        return [[self._error(T, *pair) for pair in zip(drives, self._square._asked, strict=True)] for T in self._T]

    def _error(self, T: Objective, drive: FloatArray, b: FloatArray) -> float:
        wrong = (T.T.apply(drive) - b)[self._square._inner] / self._square._white
        return float(np.mean(wrong**2)) + blurring.DARKEST


def row(name: str, near: float, blurred: float, losses: list[float]) -> str:
    return f"| {name} | {near:.1f} | {blurred:.1f} | {' | '.join(f'{loss:.2f}' for loss in losses)} |"


def main() -> None:
    shown = pictures((blurring.SIDE, blurring.SIDE))
    blurring.NAMES = tuple(shown)
    blurring.judging_pictures = lambda side: list(pictures(side).values())
    lines, columns = range(TOP, TOP + blurring.SIDE), widest()
    T, other = (rows_of(lines, columns, sampling) for sampling in range(2))
    square = blurring._Square(T, SIZE, blurring._about(T.indices, SIZE), (blurring.SIDE, blurring.SIDE))
    judges, count = Judges(square, other), T.shape[0]
    print(f"| limit | near | blurred | {' | '.join(shown)} |\n{'|---' * (3 + len(shown))}|")
    away = [row("T", T.indices.size / count, 0, judges.losses(Transport(T))[1])]
    print(row("another T", other.indices.size / count, 0, judges.losses(Transport(other))[0]), flush=True)
    for limit in map(float, LIMITS):
        near, scatter = in_cells(T, SIZE, limit)
        sizes = near.indices.size / count, scatter.indices.size / count
        by_itself, by_other = judges.losses(Transport(near, blurred=Pyramid(SIZE).light(scatter)))
        print(row(f"{limit:.4f}", *sizes, by_itself), flush=True)
        away.append(row(f"{limit:.4f}", *sizes, by_other))
    print("\njudged by another T:\n", *away, sep="\n")


if __name__ == "__main__":
    main()
