"""Located multiplexing: T from few pictures, where each camera pixel's direct light comes from one place.

A camera pixel's direct light comes from a small window of projector pixels. Stripes locate the window roughly. A code
of w × w numbers, tiled over the projector, then separates the pixels of any window, because each window contains every
number once (the local regions of parallel single-pixel imaging: Jiang et al. 2021, Parallel single-pixel imaging; here
with S-matrix codes). Far light is smooth and adds the same pedestal to every number of the tile, which is subtracted.
Where far light is not negligible, a second S-matrix separates coarse blocks, after the near light has been subtracted.

The scheme cannot separate two sharp sources of one camera pixel (a mirror, a glass edge): both fall into one window.
The check picture at the end reveals this error. The hierarchical scheme has no such limit.

S-matrices: each of n pictures lights half of n sources, and a linear system separates them. If the camera's noise
does not grow with the light, the result has 4/n of the variance of lighting each source alone (Schechner, Nayar and
Belhumeur 2003, A theory of multiplexed illumination).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from counterlight.arrays import FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.passes.colour import LUMINANCE
from counterlight.tools.acquisition.plan import (
    Captures,
    Expected,
    LazyPatterns,
    Level,
    Measured,
    Pattern,
    Reference,
    Scheme,
)
from counterlight.tools.acquisition.schemes.blocks import (
    BlockGrid,
    BlockLight,
    as_transport,
    fit_to_composition,
)
from counterlight.tools.acquisition.schemes.graycode import Stripe, locate, stripes
from counterlight.tools.acquisition.schemes.known import KnownLight

STRIPE_CELL = 2  # projector pixels: half of the least tile, so that cell and place in the tile agree on one window
LEAST_TILE, MOST_TILE = 4, 14
USUAL_TILE = 8  # tile for rooms in focus
# half width of a window, in standard deviations of the spot; 2 % of the light lie beyond it, per axis
REACH_SIGMAS = 2.3
NEIGHBOURHOOD = 16  # side, in projector pixels, of the areas in which the sharpest camera pixel gives the blur
MOST_BLURRED = 0.95  # share of the neighbourhoods for which the window is wide enough
LEAST_FAR = 0.02  # share of all light; less far light is left out
FAR_BLOCKS = 64


@dataclass(frozen=True)
class MultiplexedScheme:
    """The multiplexed scheme.

    tile : side of the window in projector pixels; None derives it from the stripes' contrast.
    sigmas : standard deviations by which a pixel of the window must rise to be kept. In simulated rooms, 3 suits sharp
        spots, and 2 suits blurred spots, whose rims are wide and weak.
    """

    tile: int | None = None
    sigmas: float = 2.5

    def __post_init__(self) -> None:
        if self.tile is not None and not LEAST_TILE <= self.tile <= MOST_TILE:
            raise InputError(f"--tile {self.tile}: expected {LEAST_TILE} to {MOST_TILE} projector pixels")

    def expected(self, projector: tuple[int, int]) -> tuple[Expected, ...]:
        tile = Tile(projector, self.tile or USUAL_TILE)
        return Expected(len(stripes(projector, STRIPE_CELL))), Expected(tile.code, share=1), _far(projector)

    def __call__(self, room: Reference, projector: tuple[int, int]) -> Scheme:
        shown = stripes(projector, STRIPE_CELL)
        later = self.expected(projector)[1:]
        captures = yield Level("stripes", LazyPatterns(len(shown), lambda i: shown[i].paint()), later)
        shares = [_lit_share(room, captures, i) for i in range(len(shown))]
        place = locate(shown, shares, projector)
        side = self.tile or choose_tile(shown, shares, place, room, projector)
        tile = Tile(projector, side)
        captures = yield Level(f"tiles of {side} px", tile.patterns, later[1:], (tile.code + 1) // 2, share=1)
        averaged = room.averaged(captures.repeats)
        near, pedestal = tile.decode(averaged, captures, place, self.sigmas)
        composition = _better_composition(averaged, captures, (tile.code + 1) // 2)
        notes = [f"stripes: {len(shown)} pictures", f"tiles of {side} px: {tile.code} pictures"]
        parts = [near]
        far_share = float(np.sum(pedestal @ LUMINANCE) * side**2 / np.sum(room.light @ LUMINANCE))
        if far_share > LEAST_FAR:
            blocks = CodedBlocks(far_grid(projector))
            captures = yield Level(f"blocks of {blocks.grid.side} px", blocks.patterns, cover=(blocks.code + 1) // 2)
            parts.append(blocks.decode(room, captures, near))
            notes.append(f"far light, {100 * far_share:.0f} %: {blocks.code} pictures of {blocks.grid.count} blocks")
        transport = as_transport(fit_to_composition(parts, composition), len(room.light))
        return Measured(transport, tuple(notes))


@dataclass(frozen=True)
class Tile:
    """A code of side × side numbers, repeated over the projector."""

    projector: tuple[int, int]
    side: int

    @property
    def code(self) -> int:
        return code_length(self.side**2)

    @property
    def patterns(self) -> LazyPatterns[Pattern]:
        height, width = self.projector
        number = np.arange(height)[:, None] % self.side * self.side + np.arange(width) % self.side
        lit = s_matrix(self.code)
        return LazyPatterns(self.code, lambda i: np.asarray(lit[i][number]))

    def decode(
        self, room: Reference, captures: Captures, place: FloatArray, sigmas: float
    ) -> tuple[BlockLight, FloatArray]:
        """Returns the light of each projector pixel in the windows, and the pedestals, (camera pixels, 3)."""
        folded = _solve(room, captures, self.code, self.side**2)
        corner = self._corners(folded @ LUMINANCE, place)
        down, right = np.mgrid[: self.side, : self.side].reshape(2, -1)
        row, column = corner[:, :1] + down, corner[:, 1:] + right
        number = row % self.side * self.side + column % self.side
        light = np.take_along_axis(folded, number[..., None], axis=1)
        corners = (down % (self.side - 1) == 0) & (right % (self.side - 1) == 0)
        pedestal = np.maximum(np.mean(light[:, corners], axis=1), 0)
        # The photon noise of each code picture is that of half the floodlight; S⁻¹ gives it a variance of 4 / n.
        sigma = 2 * room.noise.sigma(room.light / 2) / np.sqrt(self.code)
        pedestal = np.where(pedestal > sigma, pedestal, 0)
        light = light - pedestal[:, None]
        inside = (row >= 0) & (row < self.projector[0]) & (column >= 0) & (column < self.projector[1])
        kept = inside & np.any(light > sigmas * sigma[:, None], axis=2)
        camera, entry = np.nonzero(kept)
        pixel = row[camera, entry] * self.projector[1] + column[camera, entry]
        grid = BlockGrid(self.projector, 1)
        return BlockLight(grid, camera, pixel, np.maximum(light[camera, entry], 0)), pedestal

    def _corners(self, folded: FloatArray, place: FloatArray) -> IntArray:
        """Returns the upper left projector pixel of each window, (camera pixels, 2).

        The centre of light within the tile is the phase of its first harmonic, which a pedestal does not change. It
        repeats with the tile; the repetition nearest to the stripes' place is used.
        """
        square = folded.reshape(-1, self.side, self.side)
        wave = np.exp(2j * np.pi * (np.arange(self.side) + 0.5) / self.side)
        corners = []
        for axis in (0, 1):
            centre = np.angle(square.sum(axis=2 - axis) @ wave) / (2 * np.pi) * self.side
            centre += self.side * np.round((place[:, axis] - centre) / self.side)
            corners.append(np.floor(centre - self.side / 2 + 0.5).astype(np.int64))
        return np.stack(corners, axis=1)


@dataclass(frozen=True)
class CodedBlocks:
    """Blocks that cover the projector, separated by an S-matrix."""

    grid: BlockGrid

    @property
    def code(self) -> int:
        return code_length(self.grid.count)

    @property
    def patterns(self) -> LazyPatterns[Pattern]:
        lit = s_matrix(self.code)[:, : self.grid.count]
        return LazyPatterns(self.code, lambda i: self.grid.paint(np.flatnonzero(lit[i])))

    def decode(self, room: Reference, captures: Captures, near: BlockLight) -> BlockLight:
        """Returns the light of each block in each camera pixel, after the near light is subtracted."""
        known = KnownLight(len(room.light), self.grid.projector)
        known.add(near)
        patterns = self.patterns
        total = _solve(room, captures, self.code, self.grid.count, lambda i: known.seen(patterns[i]))
        camera, block = np.nonzero(np.any(total > 0, axis=2))
        return BlockLight(self.grid, camera, block, np.maximum(total[camera, block], 0))


def _far(projector: tuple[int, int]) -> Expected:
    return Expected(CodedBlocks(far_grid(projector)).code)


def far_grid(projector: tuple[int, int]) -> BlockGrid:
    """Returns the grid with the smallest blocks of which at most 64 cover the projector."""
    side = 1
    while (grid := BlockGrid(projector, side)).count > FAR_BLOCKS:
        side *= 2
    return grid


def choose_tile(
    shown: list[Stripe], shares: list[FloatArray], place: FloatArray, room: Reference, projector: tuple[int, int]
) -> int:
    """Choose the window that holds the spots of 19 of 20 neighbourhoods at any position between pixels.

    In the middle of a stripe of width s, a Gaussian spot of standard deviation σ has a contrast of 1 − 4 Φ(−s / 2σ).
    Far light lowers the contrast of wide and narrow stripes alike, so the ratio of their contrasts gives σ.
    """
    height, width = (-(-side // NEIGHBOURHOOD) for side in projector)
    where = (place // NEIGHBOURHOOD).astype(np.int64) @ np.array([width, 1])
    lit = np.any(room.light > 10 * room.noise.sigma(room.light), axis=1)
    widths = sorted({stripe.width for stripe in shown if stripe.width <= NEIGHBOURHOOD})
    contrast = {w: np.full((2, height * width), -1.0) for w in widths}
    for stripe, share in zip(shown, shares, strict=True):
        if stripe.width in contrast:
            np.maximum.at(contrast[stripe.width][stripe.axis], where[lit], np.abs(2 * share[lit] - 1))
    widest = contrast[widths[-1]]
    seen = widest > 0.2
    sigma = np.full(widest.shape, np.inf)
    for w in reversed(widths):
        lost = np.clip(1 - contrast[w] / np.where(seen, widest, 1), 1e-4, 1)
        sigma = np.where(lost < 0.7, -w / 2 / ndtri(lost / 4), sigma)
    if not seen.any():
        return LEAST_TILE
    spot = 2 * REACH_SIGMAS * np.quantile(sigma[seen], MOST_BLURRED)
    return int(np.clip(np.ceil(spot + 1), LEAST_TILE, MOST_TILE))  # windows begin at whole pixels


def _lit_share(room: Reference, captures: Captures, index: int) -> FloatArray:
    flood = room.light @ LUMINANCE
    return np.asarray(room.above_black(captures[index]) @ LUMINANCE / np.where(flood > 0, flood, np.inf))


def _better_composition(room: Reference, captures: Captures, cover: int) -> FloatArray:
    """Returns T·1 from the floodlight and captures that add up to `cover` floodlit rooms, (camera pixels, 3)."""
    total = room.repeats * room.light
    for i in range(len(captures)):
        total = total + room.above_black(captures[i])
    return np.asarray(total / (room.repeats + cover))


def _solve(
    room: Reference, captures: Captures, code: int, sources: int, known: Callable[[int], FloatArray] | None = None
) -> FloatArray:
    """Apply S⁻¹ to the captures, one at a time: (camera pixels, sources, 3)."""
    inverse = s_inverse(code)[:sources]
    total = np.zeros((len(room.light), sources, 3))
    for i in range(code):
        light = room.above_black(captures[i])
        if known is not None:
            light = light - known(i)
        total += inverse[:, i, None] * light[:, None]
    return total


def code_length(sources: int) -> int:
    """Returns the order of the S-matrix for so many sources: the least prime 4 m − 1 that is at least `sources`."""
    n = max(sources, 3)
    while n % 4 != 3 or any(n % d == 0 for d in range(3, int(n**0.5) + 1, 2)):
        n += 1
    return n


def s_matrix(n: int) -> NDArray[np.bool_]:
    """Returns the S-matrix (n, n) for n = `code_length(…)`; row i selects the (n + 1)/2 sources that picture i lights.

    The matrix is cyclic: source j is lit in picture i if i + j is 0 or a quadratic residue modulo n (Harwit and Sloane
    1979).
    """
    residue = np.zeros(n, np.bool_)
    residue[np.arange(n, dtype=np.int64) ** 2 % n] = True
    return np.asarray(residue[(np.arange(n)[:, None] + np.arange(n)) % n])


def s_inverse(n: int) -> FloatArray:
    """Returns S⁻¹ = 2 / (n + 1) · (2 Sᵀ − 1), (n, n)."""
    return np.asarray(2 / (n + 1) * (2.0 * s_matrix(n).T - 1), np.float64)
