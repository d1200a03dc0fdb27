"""The truth: a camera's light from a projector in a room, c_k = Σ_l T_kl p_l + e_k.

T = A · diag(M(s)) · (W + S G D) · H. H is the halo of the projector's lens. W is the footprints on the samples, D on
the patches; each primary has its own. G is all bounces between patches, and S maps patches to samples. M(s) is the
mixing of a sample's paint. A takes the camera's pixels as means of samples. Light is (pixels, 3) throughout: (projector
pixels, primary) or (camera pixels, channel).
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from tests.rig.footprints import footprints
from tests.rig.lens import SHARP, Emission, Lens
from tests.rig.light import Light, pigments, room_light
from tests.rig.radiosity import bounced
from tests.rig.rays import FloatArray
from tests.rig.rooms import Room

Shift = tuple[float, float]
Matrices = tuple[sparse.csr_array, ...]  # matrices of red, green and blue; one object if they are equal


@dataclass(frozen=True)
class Indirect:
    """Light that has bounced between patches: S G D.

    gather : D of each primary, (patches, projector pixels).
    scatter : S, (samples, patches).
    mix : G, (pigments, camera channel, primary, patches, patches), Σ_λ C ρ P (I − F R_λ)⁻¹ F R_λ. The walls' colours
        are part of G, so its mixing differs from direct light.
    """

    gather: Matrices
    mix: NDArray[np.float32]
    scatter: sparse.csr_array


@dataclass(frozen=True)
class Truth:
    """A room under a light, with the projector's picture shifted by some pixels, through a lens."""

    room: Room
    light: Light
    shift: Shift = (0.0, 0.0)
    lens: Lens = SHARP

    @property
    def direct(self) -> Matrices:
        """W of each primary, (samples, projector pixels with the lens' margin)."""
        margin = self.lens.margin(self.room.raster)
        return tuple(_direct(self.room, *place, margin) for place in self._places)

    @cached_property
    def emission(self) -> Emission:
        """H, the halo of the lens."""
        return Emission(self.lens, self.room.raster)

    @property
    def _places(self) -> list[tuple[Shift, float]]:
        """Shift and scale of each primary's picture."""
        (right, down), lens = self.shift, self.lens
        return [((right + x, down + y), scale) for (x, y), scale in zip(lens.shifts, lens.scales, strict=True)]

    @cached_property
    def unbounded(self) -> FloatArray:
        """Direct irradiance under a raster without borders, (samples,)."""
        hits = self.room.hits
        return np.bincount(hits.sample, hits.irradiance, minlength=len(self.room.paint))

    @cached_property
    def mixing(self) -> FloatArray:
        """M, (pigments, camera channel, primary)."""
        return self.light.mixing(pigments())

    @cached_property
    def indirect(self) -> Indirect | None:
        bounces = self.room.bounces
        if bounces is None:
            return None
        points, margin = bounces.gather.shape[1], self.lens.margin(self.room.raster)
        gathered = dict[tuple[Shift, float], sparse.csr_array]()
        for shift, scale in dict.fromkeys(self._places):
            hits = footprints(bounces.hits, points, self.room.raster, shift, scale=scale, margin=margin)
            gathered[shift, scale] = sparse.csr_array(bounces.gather @ hits, dtype=np.float32)
        spectra, count = pigments(), len(bounces.factors)
        mix = np.zeros((len(spectra), 3, 3, count, count), np.float32)
        for band in np.flatnonzero(self.light.primaries.any(axis=0) & self.light.sensitivities.any(axis=0)):
            path = bounced(bounces.factors, bounces.paint @ spectra[:, band]).astype(np.float32)
            weights = self.light.mixing(spectra * (np.arange(spectra.shape[1]) == band))
            for index in np.argwhere(weights > 1e-6 * self.mixing.max()):
                mix[tuple(index)] += np.float32(weights[tuple(index)]) * path
        return Indirect(tuple(gathered[place] for place in self._places), mix, bounces.scatter)


@lru_cache(maxsize=8)  # enough for all rooms and lights of a table
def _direct(room: Room, shift: Shift, scale: float, margin: int) -> sparse.csr_array:
    return footprints(room.hits, len(room.paint), room.raster, shift, scale=scale, margin=margin)


def _product(matrices: Matrices, light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Multiply each primary of light (pixels, 3) with its matrix."""
    if all(each is matrices[0] for each in matrices):
        return np.asarray(matrices[0] @ light)
    return np.stack([each @ primary for each, primary in zip(matrices, light.T, strict=True)], axis=1)


class View:
    """One camera's view of a truth.

    pixels : A, (camera pixels, samples).
    """

    def __init__(self, truth: Truth, pixels: sparse.csr_array) -> None:
        self._truth, self._pixels = truth, pixels
        self._paint = truth.room.paint

    def rise(self, drive: FloatArray) -> FloatArray:
        """Returns T p: (projector pixels, 3) -> (camera pixels, 3)."""
        light, mixing = self._truth.emission(drive), self._truth.mixing.astype(np.float32)
        lit = _product(self._truth.direct, light)
        seen = np.einsum("sq,qkl,sl->sk", self._paint, mixing, lit, optimize=True)
        far = self._truth.indirect
        if far is not None:
            arriving = np.einsum("qklnm,ml->nqk", far.mix, _product(far.gather, light), optimize=True)
            scattered = far.scatter @ arriving.reshape(len(arriving), -1)
            seen += np.einsum("sq,sqk->sk", self._paint, scattered.reshape(len(seen), -1, 3))
        return np.asarray(self._pixels @ seen, np.float64)

    def ambient(self) -> FloatArray:
        """Returns the room's own light relative to white: (camera pixels, 3)."""
        return np.asarray(self._pixels @ (self._paint @ self._truth.light.seen(room_light(), pigments())), np.float64)

    def direct_rise(self) -> FloatArray:
        """Returns the light under full drive without bounced light and halo: (camera pixels, 3)."""
        height, width = self._truth.room.raster
        white = self._truth.emission.unscattered(np.ones((height * width, 3))).astype(np.float32)
        lit, mixing = _product(self._truth.direct, white), self._truth.mixing
        seen = np.einsum("sq,qkl,sl->sk", self._paint, mixing, lit, optimize=True)
        return np.asarray(self._pixels @ seen, np.float64)

    def transport(self) -> "Transport":
        """Returns T as matrices, for many products."""
        mixing = self._truth.mixing
        channels = mixing.transpose(1, 2, 0).astype(np.float32)  # each of the nine has the shape (primary, pigments)
        blocks = [
            [self._weighted(self._paint @ primary) @ W for primary, W in zip(channel, self._truth.direct, strict=True)]
            for channel in channels
        ]
        near = sparse.csr_array(sparse.block_array(blocks, format="csr"))
        return Transport(near, self._far_parts(), self._truth.emission)

    def _weighted(self, colour: NDArray[np.float32]) -> sparse.csr_array:
        """Returns A · diag(colour), without zeros."""
        weighted = self._pixels.copy()
        weighted.data = weighted.data * colour[weighted.indices]
        weighted.eliminate_zeros()
        return weighted

    def _far_parts(self) -> "tuple[sparse.csr_array, NDArray[np.float32], sparse.csr_array] | None":
        far = self._truth.indirect
        if far is None:
            return None
        used = np.flatnonzero(self._paint.any(axis=0))  # pigments in use
        spread = [self._weighted(self._paint[:, pigment]) @ far.scatter for pigment in used]
        patches = far.mix.shape[-1]
        mix = far.mix[used].transpose(1, 0, 3, 2, 4).reshape(3 * len(used) * patches, 3 * patches)
        scatter, gather = (
            sparse.csr_array(sparse.block_diag(each, format="csr"))
            for each in ([sparse.hstack(spread)] * 3, far.gather)
        )
        return scatter, np.ascontiguousarray(mix), gather


@dataclass(frozen=True)
class Transport:
    """T = (near + U G D) H over stacked channels: (3 · camera pixels, 3 · projector pixels), float32.

    emission : H of the projector's lens; None is a lens without halo.
    """

    near: sparse.csr_array
    far: tuple[sparse.csr_array, NDArray[np.float32], sparse.csr_array] | None = None
    emission: Emission | None = None

    def scaled(self, factor: float) -> "Transport":
        far = None if self.far is None else (self.far[0], self.far[1] * np.float32(factor), self.far[2])
        return Transport(self.near * np.float32(factor), far, self.emission)

    @cached_property
    def _turned(self) -> tuple[sparse.csr_array, ...]:
        matrices = [self.near] if self.far is None else [self.near, self.far[0], self.far[2]]
        return tuple(sparse.csr_array(matrix.T) for matrix in matrices)

    def apply(self, drive: FloatArray) -> FloatArray:
        """Returns T p: (projector pixels, 3) -> (camera pixels, 3)."""
        light = drive if self.emission is None else self.emission(drive)
        stacked = np.ascontiguousarray(light.T, np.float32).ravel()
        seen = self.near @ stacked
        if self.far is not None:
            scatter, mix, gather = self.far
            seen = seen + scatter @ (mix @ (gather @ stacked))
        return np.asarray(seen.reshape(3, -1).T, np.float64)

    def adjoint(self, light: FloatArray) -> FloatArray:
        """Returns Tᵀ c: (camera pixels, 3) -> (projector pixels, 3)."""
        stacked = np.ascontiguousarray(light.T, np.float32).ravel()
        back = self._turned[0] @ stacked
        if self.far is not None:
            back = back + self._turned[2] @ (self.far[1].T @ (self._turned[1] @ stacked))
        gathered = np.asarray(back.reshape(3, -1).T, np.float64)
        return gathered if self.emission is None else self.emission.adjoint(gathered)
