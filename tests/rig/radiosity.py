"""Light between matt surfaces: form factors by contour integrals, and all bounces at once.

The form factor from a point with normal n to a polygon is exact (Lambert 1760): F = 1/2π Σ θ_i n·(r_i × r_{i+1})/|…|,
so that the factors of a closed room sum to 1. With R the patches' reflectance and E their direct irradiance, bounced
light arrives as H = F R (E + H), that is H = (I − F R)⁻¹ F R E.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from tests.rig.rays import FloatArray, Rectangle

SUBPOINTS = 3  # receiving points per side of a patch


@dataclass(frozen=True)
class Patches:
    """A grid of cells on a rectangle.

    grid : (rows, columns).
    """

    rectangle: Rectangle
    grid: tuple[int, int]

    @property
    def count(self) -> int:
        return self.grid[0] * self.grid[1]

    def points(self, side: int) -> FloatArray:
        """Returns (patches, side², 2), shares of the rectangle's sides, evenly spread within each patch."""
        rows, columns = self.grid
        within = (np.arange(side) + 0.5) / side
        b, a = np.meshgrid(*(((np.arange(n)[:, None] + within).ravel() / n) for n in (rows, columns)), indexing="ij")
        shares = np.stack([a, b], axis=-1).reshape(rows, side, columns, side, 2)
        return shares.transpose(0, 2, 1, 3, 4).reshape(self.count, side * side, 2)

    def outlines(self) -> FloatArray:
        """Returns (patches, 4, 3), corners in order."""
        rows, columns = self.grid
        b, a = (index.ravel() for index in np.indices(self.grid))
        corners = [np.stack([(a + i) / columns, (b + j) / rows], axis=1) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
        return np.stack([self.rectangle.point(corner) for corner in corners], axis=1)

    def interpolation(self, shares: FloatArray) -> sparse.csr_array:
        """Returns (points, patches): interpolation between the four nearest patches' middles, constant at the rim."""
        rows, columns = self.grid
        axes = []
        for share, cells in ((shares[:, 0], columns), (shares[:, 1], rows)):
            at = np.clip(share * cells - 0.5, 0, cells - 1)
            low = np.minimum(np.floor(at).astype(np.int64), max(cells - 2, 0))
            axes.append((low, np.minimum(low + 1, cells - 1), at - low))
        (left, right, x), (top, bottom, y) = axes
        number = np.arange(len(shares))
        corners = (
            (top, left, (1 - y) * (1 - x)),
            (top, right, (1 - y) * x),
            (bottom, left, y * (1 - x)),
            (bottom, right, y * x),
        )
        entries = [(weight, number, row * columns + column) for row, column, weight in corners]
        values, points, cells_ = (np.concatenate(each) for each in zip(*entries, strict=True))
        return sparse.csr_array(sparse.coo_array((values, (points, cells_)), shape=(len(shares), self.count)))


def point_factors(points: FloatArray, normals: FloatArray, outlines: FloatArray) -> FloatArray:
    """Returns F from points to polygons that lie wholly above their horizons: (points, polygons).

    points, normals : (n, 3).
    outlines : (m, corners, 3).
    """
    towards = outlines[None] - points[:, None, None]
    lengths = np.linalg.norm(towards, axis=-1, keepdims=True)
    unit = towards / np.maximum(lengths, 1e-300)
    following = np.roll(unit, -1, axis=2)
    cross = np.cross(unit, following)
    sine = np.linalg.norm(cross, axis=-1)
    angle = np.arctan2(sine, np.sum(unit * following, axis=-1))
    edges = angle / np.maximum(sine, 1e-12) * np.einsum("nmci,ni->nmc", cross, normals)
    return np.abs(edges.sum(axis=2)) / (2 * np.pi)


def form_factors(surfaces: list[Patches]) -> FloatArray:
    """Returns (patches, patches) of all surfaces in turn; 0 within a plane. Nothing may occlude (a convex room)."""
    rows = []
    for receiver in surfaces:
        shares = receiver.points(SUBPOINTS)
        at = receiver.rectangle.point(shares).reshape(-1, 3)
        normal = np.broadcast_to(receiver.rectangle.normal, at.shape)
        blocks = []
        for sender in surfaces:
            if sender is receiver:
                blocks.append(np.zeros((receiver.count, sender.count)))
                continue
            factors = point_factors(at, normal, sender.outlines())
            blocks.append(factors.reshape(receiver.count, -1, sender.count).mean(axis=1))
        rows.append(np.concatenate(blocks, axis=1))
    return np.concatenate(rows, axis=0)


def bounced(factors: FloatArray, reflectance: FloatArray) -> FloatArray:
    """Returns H for a unit of direct irradiance on each patch, after any number of bounces: (patches, patches)."""
    once = factors * reflectance
    return np.asarray(np.linalg.solve(np.eye(len(factors)) - once, once))
