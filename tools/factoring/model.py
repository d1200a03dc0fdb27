"""Fit far light by smooth functions times the textures of both surfaces, by least squares: far ≈ A M Bᵀ.

F = far·1 and G = 1ᵀfar are the textures of the camera's and the projector's pixels. A = diag(F) Φ and B = diag(G) Ψ
interpolate linearly between the nodes of two grids, and

    M = (AᵀA + ε)⁻¹ Aᵀ far B (BᵀB + ε)⁻¹

is the least-squares fit. Near entries are only known once far light is known. In their places, the fit uses the model
of the previous round (expectation and maximisation, three rounds).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.factoring import passes
from counterlight.tools.transport.transport import Csr, Dense, FarLight, Shape, Transport, channel

ROUNDS = 3
RIDGE = 1e-6  # ε relative to the mean diagonal; nodes without far light stay 0
PEAK = 64.0  # multiple of its row's mean above which an entry starts as near light
# CROWD: a block that sends this multiple of its share is near light, too; BLOCKS: number of blocks of the raster
CROWD, BLOCKS = 8.0, 108
MOST_SCALED = 2.0  # largest factor by which a row of U may grow or shrink
FAINTEST = 1e-6  # share of a row's light; below it is float32 rounding, not missed light


@dataclass(frozen=True)
class Grid:
    """Φ, (pixels, nodes): interpolates each pixel between four nodes; clamped beyond the outer nodes.

    nodes : rows and columns of nodes.
    corners : (pixels, 4) int32. The nodes of each pixel.
    weights : (pixels, 4). ≥ 0, with sum 1.
    """

    nodes: Shape
    corners: NDArray[np.int32]
    weights: FloatArray

    @classmethod
    def over(cls, picture: Shape, count: int) -> "Grid":
        """Make about `count` nodes at equal distances down and across, at most one per two pixels of a side.

        picture : (height, width).
        """
        apart = max(2.0, np.sqrt(picture[0] * picture[1] / count))
        rows, columns = (max(1, round(side / apart)) for side in picture)
        (top, bottom, y), (left, right, x) = (_between(*each) for each in zip(picture, (rows, columns), strict=True))
        above, below = columns * top[:, None], columns * bottom[:, None]
        corners = np.stack([above + left, above + right, below + left, below + right], axis=-1)
        down = y[:, None]
        weights = np.stack([(1 - down) * (1 - x), (1 - down) * x, down * (1 - x), down * x], axis=-1)
        return cls((rows, columns), corners.reshape(-1, 4).astype(np.int32), weights.reshape(-1, 4))

    @property
    def count(self) -> int:
        return self.nodes[0] * self.nodes[1]

    def textured(self, texture: FloatArray) -> Csr:
        """Returns diag(texture) Φ without zeros; texture is (pixels,)."""
        pixels = len(self.corners)
        places = self.corners.ravel(), 4 * np.arange(pixels + 1)
        matrix = sparse.csr_array(((self.weights * texture[:, None]).ravel(), *places), shape=(pixels, self.count))
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
        return matrix

    def rows(self, textures: FloatArray, columns: int) -> SparseRows:
        """Returns diag(texture) Φ of three channels, padded to `columns` columns; textures is (pixels, 3)."""
        weights = (self.weights[:, :, None] * textures[:, None]).reshape(-1, 3)
        places = 4 * np.arange(len(self.corners) + 1)
        return SparseRows(places, self.corners.ravel(), weights, columns).where((weights != 0).any(axis=1))


def _between(pixels: int, nodes: int) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Returns the nodes before and after each pixel of a side, and the pixel's position between them, 0 to 1."""
    at = np.clip((np.arange(pixels) + 0.5) / pixels * nodes - 0.5, 0, nodes - 1)
    before = np.minimum(at.astype(np.int64), max(nodes - 2, 0))
    return before, np.minimum(before + 1, nodes - 1), at - before


@dataclass(frozen=True)
class Model:
    """far ≈ diag(F) Φ M Ψᵀ diag(G).

    camera, projector : Φ, Ψ.
    F : (camera pixels, 3).
    G : (projector pixels, 3).
    M : (camera nodes, projector nodes, 3).
    limit : entries that exceed the model by more than limit · F / n are near light.
    """

    camera: Grid
    projector: Grid
    F: FloatArray
    G: FloatArray
    M: FloatArray
    limit: float

    @property
    def textures(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """F, G, M in the order of the loops' arguments."""
        return self.F, self.G, self.M

    @property
    def grids(self) -> tuple[NDArray[np.int32], FloatArray, NDArray[np.int32], FloatArray]:
        """Φ, Ψ in the order of the loops' arguments."""
        return self.camera.corners, self.camera.weights, self.projector.corners, self.projector.weights

    def far_light(self) -> FarLight:
        """Returns U M D."""
        cells = max(self.M.shape[:2])  # M is square: if a side has fewer cells, cells without light are added
        mix = np.zeros((3, cells, cells))
        mix[:, : self.M.shape[0], : self.M.shape[1]] = self.M.transpose(2, 0, 1)
        return FarLight(self.projector.rows(self.G, cells).transposed, Dense(mix), self.camera.rows(self.F, cells))


@dataclass(frozen=True)
class Rows:
    """T in the form that the fit reads.

    transport : near light, and far light if T already has some.
    apart : (entries,) bool. Entries that start as near light.
    """

    transport: Transport
    apart: NDArray[np.bool_]

    @classmethod
    def of(cls, transport: Transport) -> "Rows":
        assert transport.projector is not None
        labels, shares = _blocks(transport.projector)
        return cls(transport, passes.concentrated(*passes.operands(transport.near), labels, shares, PEAK, CROWD))

    @property
    def near(self) -> SparseRows:
        return self.transport.near

    @property
    def relative(self) -> bool:
        """Whether near light is measured above the model; False if T already separates far light from its entries."""
        return self.transport.far is None

    @cached_property
    def known(self) -> tuple[FloatArray, FloatArray]:
        """F and G of the far light that T already has."""
        (rows, columns), far = self.transport.shape, self.transport.far
        if far is None:
            return np.zeros((rows, 3)), np.zeros((columns, 3))
        return far.apply(np.ones((columns, 3))), far.apply_transpose(np.ones((rows, 3)))


def fitted(rows: Rows, cells: tuple[int, int], limit: float) -> Model:
    """Fit the model on about so many nodes of the camera and the projector; deterministic."""
    camera, projector = rows.transport.camera, rows.transport.projector
    assert camera is not None
    assert projector is not None
    grids = Grid.over(camera, cells[0]), Grid.over(projector, cells[1])
    shape = rows.near.shape
    nothing = np.zeros((grids[0].count, grids[1].count, 3))
    model = Model(*grids, rows.near.sums(), np.zeros((shape[1], 3)), nothing, limit)
    for done in range(ROUNDS + 1):
        mixed, F, G = _projected(rows, model)
        model = replace(model, M=_solved(model, mixed)) if done else model
        if done < ROUNDS:
            model = replace(model, F=F, G=G)
    return model


def _projected(rows: Rows, model: Model) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns Aᵀ far B, F and G of the far light, as the present model separates it from near light."""
    entries = passes.operands(rows.near)
    scales = rows.apart, rows.relative, model.limit
    parts, F, sent = passes.projected(*entries, *scales, *model.textures, *model.grids)
    mixed, G = parts.sum(axis=0), sent.sum(axis=0)
    far = rows.transport.far
    if far is not None:
        camera = model.camera.corners, model.camera.weights, model.camera.count
        AU = passes.onto_nodes(*passes.operands(far.scatter), far.scatter.columns, model.F, *camera).sum(axis=0)
        for i in range(3):
            B = model.projector.textured(model.G[:, i])
            mixed[..., i] += AU[..., i] @ far.mix.matrices[i] @ (channel(far.gather, i) @ B).toarray()
    return mixed, F + rows.known[0], G + rows.known[1]


def _solved(model: Model, mixed: FloatArray) -> FloatArray:
    """Returns M of each channel from Aᵀ far B."""
    M = np.empty_like(mixed)
    for i in range(3):
        A, B = model.camera.textured(model.F[:, i]), model.projector.textured(model.G[:, i])
        left, right = _gram(A), _gram(B)
        M[..., i] = np.linalg.solve(right, np.linalg.solve(left, mixed[..., i]).T).T
    return M


def _gram(A: Csr) -> FloatArray:
    """Returns AᵀA + ε; the identity for a channel without far light."""
    gram = np.asarray((A.T @ A).toarray(), np.float64)
    mean = np.trace(gram) / len(gram)
    return gram + (RIDGE * mean if mean > 0 else 1.0) * np.eye(len(gram))


def _blocks(raster: Shape) -> tuple[NDArray[np.int32], FloatArray]:
    """Returns the block of each projector pixel, and each block's share of the pixels."""
    grid = Grid.over(raster, BLOCKS)
    nearest = np.take_along_axis(grid.corners, grid.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    return nearest, np.bincount(nearest, minlength=grid.count) / nearest.size


def split(rows: Rows, model: Model) -> Transport:
    """Split T into S + U M D: S holds the entries that exceed the model by its limit; U's rows are scaled to keep T·1.

    A row whose far light needs a scale beyond MOST_SCALED keeps all its entries and has no far light.
    """
    whole = rows.transport.composition()
    keep = passes.beyond(*passes.operands(rows.near), rows.relative, model.limit, *model.textures, *model.grids)
    far = model.far_light()
    shone = far.apply(np.ones((rows.near.shape[1], 3)))
    near = _above(rows.near.where(keep), model) if rows.relative else rows.near.where(keep)
    rest = whole - near.sums()
    scale = np.divide(rest, shone, out=np.zeros_like(shone), where=shone > 0)
    astray = (rest > FAINTEST * whole) & ((scale < 1 / MOST_SCALED) | (scale > MOST_SCALED))
    if rows.relative:
        which = np.asarray(astray.any(axis=1))
        near = _whole_rows(rows.near, near, which)
        scale[which] = 0
    scale = np.maximum(scale, 0)
    return replace(rows.transport, near=near, far=replace(far, scatter=far.scatter.scaled(scale)))


def _above(near: SparseRows, model: Model) -> SparseRows:
    """Subtract the model at the same places; ≥ 0."""
    entries = passes.operands(near)
    below = passes.explained(*entries[:2], *model.textures, *model.grids)
    return replace(near, weights=np.maximum(near.weights - below, 0).astype(near.weights.dtype))


def _whole_rows(full: SparseRows, near: SparseRows, which: NDArray[np.bool_]) -> SparseRows:
    """Replace some rows of `near` by the rows of `full`; `which` is (camera pixels,)."""
    if not which.any():
        return near
    kept, added = near.where(~which[near.rows]), full.where(which[full.rows])
    rows = np.concatenate([kept.rows, added.rows])
    order = np.argsort(rows, kind="stable")
    return SparseRows(
        kept.indptr + added.indptr,
        np.concatenate([kept.indices, added.indices])[order],
        np.concatenate([kept.weights, added.weights])[order],
        near.columns,
    )
