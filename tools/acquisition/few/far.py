"""Far light that is smooth over the camera picture and the projector picture, so that few pictures determine it.

Camera pixels get the share Φ u_l D p_l of primary l's light as far light. D averages over coarse cells of the
projector, and Φ interpolates linearly between nodes of the camera picture. The share depends on the primary, because
far light has met coloured walls. At each node, u is the most likely value given all camera pixels nearby, whatever the
shapes of their spots. The prior of u is nearly even, with similar deviations in neighbouring cells.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.acquisition.few.seen import Seen, Table
from counterlight.tools.factoring.model import Grid
from counterlight.tools.transport.transport import Csr, Dense, FarLight, Shape, stacked

CELLS = 48  # approximate number of cells of the projector
MOST_READ = 1 << 13  # pixels that one cell reads or lights: half of a texture's row (maps/row_map.py)
LEAST_NODES, MOST_NODES = 192, 1500  # nodes over the camera picture; a dense matrix mixes them
SPREAD, ALIKE = 0.7, 1.0  # relative standard deviation of a cell's share, and correlation length of the shares in cells
# NEARER: extra light from cells near a spot, relative to other cells; CLOSE: σ of "near" in cells
NEARER, CLOSE = 5.0, 1.5


@dataclass(frozen=True)
class Cells:
    """Coarse cells of the projector's raster, each cut into `finer` × `finer` parts that fit into a texture's row."""

    projector: Shape

    @cached_property
    def grid(self) -> Shape:
        """Rows and columns of cells."""
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
        """Returns the cell of each projector pixel, (projector pixels,)."""
        down, across = (
            np.arange(side) * (finer * count) // side for side, count in zip(self.projector, self.grid, strict=True)
        )
        return np.asarray(down[:, None] * (finer * self.grid[1]) + across).ravel()

    def means(self, drive: FloatArray) -> FloatArray:
        """Returns D p, (cells, 3), of a picture (projector pixels, 3)."""
        labels = self.labels()
        sums = [np.bincount(labels, drive[:, i], self.count) for i in range(3)]
        return np.asarray(np.stack(sums, axis=1) / np.bincount(labels, minlength=self.count)[:, None])

    @property
    def places(self) -> FloatArray:
        """Positions of the cells, in cells, (cells, 2)."""
        return np.indices(self.grid).reshape(2, -1).T.astype(np.float64)


@dataclass(frozen=True)
class Far:
    """Far light of a room.

    nodes : Φ.
    shares : (nodes, primary, cells). u.
    means : (pictures, cells, 3). D p of all pictures.
    mixture : mixture of the camera pixels' primaries (seen.py).
    own : (camera pixels, 3). Far light of each pixel relative to its neighbours.
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
        """Returns Φ u of some camera pixels, (n, primary, cells)."""
        corners, weights = self.nodes.corners[pixels], self.nodes.weights[pixels]
        return np.asarray(np.einsum("nl,ni,nilc->nlc", self.own[pixels], weights, self.shares[corners], optimize=True))

    @cached_property
    def total(self) -> FloatArray:
        """Far light as a share of each primary's light, (camera pixels, 3)."""
        return self.own * self.around

    @cached_property
    def around(self) -> FloatArray:
        """Like `total`, but with each pixel's far light equal to the mean far light of its neighbours."""
        return np.asarray(np.einsum("ni,nil->nl", self.nodes.weights, self.shares.sum(axis=2)[self.nodes.corners]))

    @cached_property
    def near_mixture(self) -> FloatArray:
        """Share of each primary's light that is near, per channel: (camera pixels, channel, primary)."""
        return np.asarray(self.mixture * (1 - self.total)[:, None])

    def shown(self, pixels: IntArray, pictures: Sequence[int]) -> FloatArray:
        """Returns the far part of each primary's share of pictures, (n, pictures, 3)."""
        return np.asarray(np.einsum("nlc,pcl->npl", self.of(pixels), self.means[pictures]))

    def seen(self, pixels: IntArray, pictures: Sequence[int]) -> FloatArray:
        """Returns the far part of pictures as the channels see it, (n, pictures · 3)."""
        seen = np.einsum("npl,nkl->npk", self.shown(pixels, pictures), self.mixture[pixels])
        return np.asarray(seen).reshape(len(pixels), -1)

    def design(self, pixels: IntArray, pictures: Sequence[int], near: FloatArray) -> FloatArray:
        """Returns the derivative of the captures by u, (n, pictures · 3, 3 · cells); near light shrinks as u grows.

        near : (n, pictures, 3). Shares of the pictures if all light were near.
        """
        apart = self.means[pictures].transpose(0, 2, 1) - near[..., None]
        seen = self.mixture[pixels][:, None, :, :, None] * apart[:, :, None]
        return np.asarray(seen.reshape(len(pixels), -1, 3 * self.cells.count))

    def far_light(self, light: FloatArray) -> FarLight:
        """Returns U M D; `light` is the primaries' light, (camera pixels, channel, primary)."""
        labels = self.cells.labels(self.cells.finer)
        fine, count = int(labels.max()) + 1, max(int(labels.max()) + 1, self.nodes.count)
        area = np.bincount(labels, minlength=fine)
        D = Csr((1 / area[labels], (labels, np.arange(labels.size))), shape=(count, labels.size))
        of_fine = np.zeros((self.cells.count, count))  # share of its coarse cell that each fine cell covers
        np.add.at(of_fine, (self.cells.labels(), labels), 1.0)
        of_fine /= of_fine.sum(axis=1, keepdims=True)
        mix = np.zeros((3, count, count))
        mix[:, : self.nodes.count] = self.shares.transpose(1, 0, 2) @ of_fine
        # M of a channel is the M of its own primary; the amount of far light comes from all primaries.
        far = np.einsum("nkl,nl->nk", light, self.total)
        textures = np.divide(far, self.around, out=np.zeros_like(far), where=self.around > 0)
        return FarLight(stacked([D] * 3), Dense(mix), self.nodes.rows(np.maximum(textures, 0), count))


def likeliest(
    cells: Cells, even: FloatArray, place: FloatArray, information: FloatArray, evidence: FloatArray
) -> FloatArray:
    """Solve (J + K⁻¹) u = h + K⁻¹ u₀ at each node; returns u, (nodes, 3, cells), ≥ 0.

    even : (nodes,). Σ u₀.
    place : (nodes, 2). Mean place that its camera pixels see, in projector pixels.
    information : (nodes, 3 · cells, 3 · cells). J.
    evidence : (nodes, 3 · cells). h.
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
    u = np.linalg.solve(information + prior, evidence[..., None] + prior @ mean[..., None])[..., 0]
    return np.maximum(u, 0).reshape(-1, 3, cells.count)
