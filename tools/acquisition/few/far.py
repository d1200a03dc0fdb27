"""Far light: smooth over the camera's picture and over the projector's, so that few pictures tell it.

Of primary l's light, camera pixels get the share Φ u_l D p_l that way, D the means over coarse cells of the projector
and Φ linear between nodes over the camera's picture: light that has met coloured walls is of another share for each.
Around each node, u is the likeliest after what all camera pixels there saw, whatever the shapes of their spots: as even
as it may be, its deviations alike in cells that are near each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.acquisition.few.seen import Seen, Table
from counterlight.tools.factoring.grid import Grid
from counterlight.tools.transport.transport import Csr, FarLight, Shape, stacked

CELLS = 48  # of the projector, about
MOST_READ = 1 << 13  # pixels that one cell reads or lights: half of a texture's row (maps/row_map.py)
LEAST_NODES, MOST_NODES = 192, 1500  # over the camera's picture; they are mixed by a dense matrix
SPREAD, ALIKE = 0.7, 1.0  # of a cell's share: its standard deviation, relative; cells over which it is alike
NEARER, CLOSE = 5.0, 1.5  # how much more light comes from next to a spot than from elsewhere, and up to how many cells


@dataclass(frozen=True)
class Cells:
    """Coarse cells of the projector's raster, each of `finer` × `finer` that are small enough for a texture's row."""

    projector: Shape

    @cached_property
    def grid(self) -> Shape:
        """Rows and columns."""
        apart = np.sqrt(self.projector[0] * self.projector[1] / CELLS)
        rows, columns = (int(np.clip(round(side / apart), 1, side)) for side in self.projector)
        return rows, columns

    @property
    def count(self) -> int:
        return self.grid[0] * self.grid[1]

    @cached_property
    def finer(self) -> int:
        largest = self.projector[0] * self.projector[1] / self.count
        return int(np.ceil(np.sqrt(1.2 * largest / MOST_READ)))

    def labels(self, finer: int = 1) -> IntArray:
        """The cell of each projector pixel, (projector pixels,)."""
        down, across = (
            np.arange(side) * (finer * count) // side for side, count in zip(self.projector, self.grid, strict=True)
        )
        return np.asarray(down[:, None] * (finer * self.grid[1]) + across).ravel()

    def means(self, drive: FloatArray) -> FloatArray:
        """D p, (cells, 3), of a picture (projector pixels, 3)."""
        labels = self.labels()
        sums = [np.bincount(labels, drive[:, i], self.count) for i in range(3)]
        return np.asarray(np.stack(sums, axis=1) / np.bincount(labels, minlength=self.count)[:, None])

    @property
    def places(self) -> FloatArray:
        """Of their middles, in cells, (cells, 2)."""
        return np.indices(self.grid).reshape(2, -1).T.astype(np.float64)


@dataclass(frozen=True)
class Far:
    """shares : u, (nodes, primary, cells).  nodes : Φ.  means : D p of all pictures, (pictures, cells, 3).
    mixture : of the camera pixels' primaries (seen.py).  own : (camera pixels, 3), how much of it each has beside its
    neighbours.
    """

    cells: Cells
    nodes: Grid
    shares: FloatArray
    means: FloatArray
    mixture: FloatArray
    own: FloatArray

    @classmethod
    def none(cls, seen: Seen, table: Table) -> "Far":
        cells = Cells(seen.order.projector)
        pixels = seen.camera[0] * seen.camera[1]
        nodes = Grid.over(seen.camera, int(np.clip(4 * pixels // MOST_READ, LEAST_NODES, MOST_NODES)))
        means = np.stack([cells.means(table[codes, np.arange(3)]) for codes in seen.codes])
        return cls(cells, nodes, np.zeros((nodes.count, 3, cells.count)), means, seen.mixture, np.ones((pixels, 3)))

    def of(self, pixels: IntArray | slice) -> FloatArray:
        """Φ u, (n, primary, cells)."""
        corners, weights = self.nodes.corners[pixels], self.nodes.weights[pixels]
        return np.asarray(np.einsum("nl,ni,nilc->nlc", self.own[pixels], weights, self.shares[corners], optimize=True))

    @cached_property
    def total(self) -> FloatArray:
        """Far light as a share of each primary's light, (camera pixels, 3)."""
        return self.own * self.around

    @cached_property
    def around(self) -> FloatArray:
        """The same if each had as much as its neighbours."""
        return np.asarray(np.einsum("ni,nil->nl", self.nodes.weights, self.shares.sum(axis=2)[self.nodes.corners]))

    @cached_property
    def near_mixture(self) -> FloatArray:
        """What the camera's channels see of each primary's light that is not far: (camera pixels, channel, primary)."""
        return np.asarray(self.mixture * (1 - self.total)[:, None])

    def shown(self, pixels: IntArray, pictures: Sequence[int]) -> FloatArray:
        """What it adds to each primary's share of pictures, (n, pictures, 3)."""
        return np.asarray(np.einsum("nlc,pcl->npl", self.of(pixels), self.means[pictures]))

    def seen(self, pixels: IntArray, pictures: Sequence[int]) -> FloatArray:
        """The same as channels see it, (n, pictures · 3)."""
        seen = np.einsum("npl,nkl->npk", self.shown(pixels, pictures), self.mixture[pixels])
        return np.asarray(seen).reshape(len(pixels), -1)

    def design(self, pixels: IntArray, pictures: Sequence[int], near: FloatArray) -> FloatArray:
        """What channels see of more of u, and less of near light, (n, pictures · 3, 3 · cells).

        near : shares of the pictures that near light alone would give, (n, pictures, 3).
        """
        apart = self.means[pictures].transpose(0, 2, 1) - near[..., None]
        seen = self.mixture[pixels][:, None, :, :, None] * apart[:, :, None]
        return np.asarray(seen.reshape(len(pixels), -1, 3 * self.cells.count))

    def far_light(self, light: FloatArray) -> FarLight:
        """U M D; light : of the primaries, (camera pixels, channel, primary)."""
        labels = self.cells.labels(self.cells.finer)
        fine, count = int(labels.max()) + 1, max(int(labels.max()) + 1, self.nodes.count)
        area = np.bincount(labels, minlength=fine)
        D = Csr((1 / area[labels], (labels, np.arange(labels.size))), shape=(count, labels.size))
        of_fine = np.zeros((self.cells.count, count))  # what part of a coarse cell each of the fine ones is
        np.add.at(of_fine, (self.cells.labels(), labels), 1.0)
        of_fine /= of_fine.sum(axis=1, keepdims=True)
        mix = np.zeros((3, count, count))
        mix[:, : self.nodes.count] = self.shares.transpose(1, 0, 2) @ of_fine
        # M of a channel is that of its own primary; how much of it there is, is of all of them.
        far = np.einsum("nkl,nl->nk", light, self.total)
        textures = np.divide(far, self.around, out=np.zeros_like(far), where=self.around > 0)
        return FarLight(stacked([D] * 3), mix, self.nodes.rows(np.maximum(textures, 0), count))


def likeliest(
    cells: Cells, even: FloatArray, place: FloatArray, information: FloatArray, told: FloatArray
) -> FloatArray:
    """u of each node, (nodes, 3, cells), ≥ 0: (J + K⁻¹) u = h + K⁻¹ u₀.

    even : (nodes,), Σ u₀.  place : (nodes, 2), of what its camera pixels see, in projector pixels.
    information : J, (nodes, 3 · cells, 3 · cells).  told : h, (nodes, 3 · cells).
    """
    apart = cells.places[:, None] - cells.places
    alike = np.exp(-(apart**2).sum(axis=2) / (2 * ALIKE**2)) + 0.02 * np.eye(cells.count)
    inverse = np.kron(np.eye(3), np.linalg.inv(alike))
    middle = (place + 0.5) / cells.projector * cells.grid - 0.5
    close = np.exp(-((middle[:, None] - cells.places) ** 2).sum(axis=2) / (2 * CLOSE**2))
    more = np.tile(1 + NEARER * close, 3)
    mean = np.maximum(even, 1e-3)[:, None] * more * (3 / more.sum(axis=1, keepdims=True))
    loose = 1 / (SPREAD * mean)
    prior = inverse * loose[:, :, None] * loose[:, None]
    u = np.linalg.solve(information + prior, told[..., None] + prior @ mean[..., None])[..., 0]
    return np.maximum(u, 0).reshape(-1, 3, cells.count)
