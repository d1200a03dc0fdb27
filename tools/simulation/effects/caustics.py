"""Caustics: projector light that reaches a surface through glass or coats, deposited on a light map (beams.py).

The map's texels cover the (u, v) of each surface, in a front and a back layer. On meshes without (u, v) the facets are
the texels. A deposit of flux is split over the four texels around it with bilinear weights, and reading uses the same
weights. The map holds irradiance per unit drive, texels × projector pixels. The finest texels are about half as wide as
the projector's pixels on the surface. Wide beams use coarser levels, and the levels are summed.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.simulation.assembly import summed, thinned
from counterlight.tools.simulation.effects.beams import COARSER, LEVELS, deposits
from counterlight.tools.simulation.effects.sequence import even_pairs
from counterlight.tools.simulation.paths import Arrivals, Deposits, Samples
from counterlight.tools.simulation.scene import Scene
from counterlight.tools.simulation.shapes.shape import Shape
from counterlight.tools.simulation.shapes.triangles import Triangles
from counterlight.tools.transport.transport import Csr

if TYPE_CHECKING:
    from counterlight.tools.simulation.effects_on import EffectsOn

FINENESS = 2.0  # texels per width of a projector pixel
MOST_TEXELS = 2048  # texels per axis
SUMMED_AT_ONCE = 1 << 22
FAINT = 0.02  # fraction of a texel's largest entry; smaller entries are dropped, the rest is scaled
NOTHING = 1e-30  # replaces 0, which scipy's products would drop from the pattern of one channel
Places = Samples | Deposits


@dataclass(frozen=True)
class Texels:
    """One level of the map on one surface: across along u, along v; the back layer follows the front layer.

    first : number of the first texel.
    areas : (across · along,), square metres.
    by_facet : whether the texels are facets; `across` is then their number.
    """

    shape: Shape
    across: int
    along: int
    first: int
    areas: FloatArray
    by_facet: bool

    @property
    def count(self) -> int:
        return 2 * self.across * self.along

    @property
    def pitch(self) -> tuple[float, float]:
        """A texel's size in u and v."""
        low, high = self.shape.v_range
        return 1 / self.across, (high - low) / self.along

    def around(self, places: Places) -> tuple[IntArray, FloatArray]:
        """Returns the texels around each place and their bilinear weights, (4, n) each; (1, n) for facets."""
        layer = self.first + ~places.front * (self.across * self.along)
        if self.by_facet:
            return (layer + places.facet)[None], np.ones((1, places.facet.size))
        pitch_u, pitch_v = self.pitch
        x, y = places.u / pitch_u - 0.5, (places.v - self.shape.v_range[0]) / pitch_v - 0.5
        i, j = np.floor(x), np.floor(y)
        s, t = x - i, y - j
        columns = np.stack([i, i + 1, i, i + 1]).astype(np.int64)
        rows = np.clip(np.stack([j, j, j + 1, j + 1]).astype(np.int64), 0, self.along - 1)
        columns = columns % self.across if self.shape.wraps else np.clip(columns, 0, self.across - 1)
        weights = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t])
        return layer + rows * self.across + columns, weights

    def near(self, places: Places) -> tuple[IntArray, FloatArray]:
        """Returns one texel of `around` per place, drawn by weight; the mean over a pixel's samples stays the same."""
        texel, weight = self.around(places)
        drawn = np.sum(np.cumsum(weight, axis=0)[:-1] < even_pairs(places.u.size)[:, 0], axis=0)
        return texel[drawn, np.arange(drawn.size)][None], np.ones((1, drawn.size))

    def deposits(self, surface: int, texel: IntArray, pixel: IntArray, irradiance: FloatArray) -> Deposits:
        """Returns the flux that texels hold from projector pixels.

        texel, pixel : (n,). Texels count from 0 within this level.
        """
        place, back = texel % self.areas.size, texel >= self.areas.size
        u, v = np.zeros(place.size), np.zeros(place.size)
        if isinstance(self.shape, Triangles) and self.by_facet:
            point = self.shape.vertices[self.shape.faces].mean(axis=1)[place]
            normal = self.shape.facet_normals[place]
        else:
            (pitch_u, pitch_v), low = self.pitch, self.shape.v_range[0]
            u += (place % self.across + 0.5) * pitch_u
            v += low + (place // self.across + 0.5) * pitch_v
            point, normal = self.shape.at(u, v), self.shape.normals(u, v)
        places = np.full(place.size, surface), u, v, place, ~back, point, np.where(back[:, None], -1.0, 1.0) * normal
        return Deposits(pixel, *places, irradiance * self.areas[place, None], "caustics")


class LightMap:
    """Irradiance per unit drive, (texels, projector pixels) per channel; the channels share one pattern.

    texels : the levels of each matt surface by its index, the finest first.
    """

    def __init__(self, scene: Scene, effects: "EffectsOn") -> None:
        self.texels = cut_into_texels(scene)
        pitches = {index: levels[0].pitch for index, levels in self.texels.items() if not levels[0].by_facet}
        self.light = _laid_down(deposits(scene, effects, pitches), self.texels, scene.projector.pixels)

    def deposits(self) -> list[Deposits]:
        """Returns the light of the map for the far light's cells; the light of each texel is at its centre."""
        held = np.repeat(np.arange(self.light[0].shape[0]), np.diff(self.light[0].indptr))
        pixel = self.light[0].indices.astype(np.int64)
        irradiance = np.stack([light.data for light in self.light], axis=1)
        result = []
        for index, levels in self.texels.items():
            for grid in levels:
                on = (held >= grid.first) & (held < grid.first + grid.count)
                result.append(grid.deposits(index, held[on] - grid.first, pixel[on], irradiance[on]))
        return result

    def arrivals(self, samples: Samples) -> list[Arrivals]:
        """Returns the light of the map at samples; its origin is NaN, because it comes from several directions."""
        result = []
        for index, levels in self.texels.items():
            on = np.flatnonzero(samples.surface == index)
            if on.size:
                found = self._read(levels, samples.at(on), on)
                if found.sample.size:
                    result.append(found)
        return result

    def _read(self, levels: list[Texels], samples: Samples, index: IntArray) -> Arrivals:
        read = [levels[0].around(samples), *(grid.near(samples) for grid in levels[1:])]
        texel, weight = (np.concatenate(parts) for parts in zip(*read, strict=True))
        held = np.diff(self.light[0].indptr)[texel].sum(axis=0) > 0
        texel, weight, index = texel[:, held], weight[:, held], index[held]
        rows = np.broadcast_to(np.arange(index.size), texel.shape)
        shape = index.size, self.light[0].shape[0]
        reading = sparse.csr_array((weight.ravel(), (rows.ravel(), texel.ravel())), shape=shape)
        # The channels share one pattern, so their entries have one order.
        channels = [reading @ light for light in self.light]
        sample = np.repeat(index, np.diff(channels[0].indptr))
        irradiance = np.stack([channel.data for channel in channels], axis=1)
        nowhere = np.broadcast_to(np.nan, (sample.size, 3))
        return Arrivals(sample, channels[0].indices.astype(np.int64), irradiance, nowhere, "caustics")


def light_map(scene: Scene, effects: "EffectsOn") -> LightMap:
    """Returns the map of the light that the active effects send forward."""
    return LightMap(scene, effects)


def cut_into_texels(scene: Scene) -> dict[int, list[Texels]]:
    """Returns the levels of every matt surface, by its index."""
    result: dict[int, list[Texels]] = {}
    first = 0
    projector = scene.projector
    for index, surface in enumerate(scene.surfaces):
        if not surface.matt:
            continue
        shape = surface.shape
        if isinstance(shape, Triangles) and shape.grid is None:
            levels = [Texels(shape, len(shape.faces), 1, first, shape.face_areas, True)]
            first += levels[0].count
        else:
            levels = []
            lengths, nearest = _extent(shape, projector.position)
            width = 2 * projector.tan_half[0] / projector.width * nearest / FINENESS
            for level in range(LEVELS):
                size = width * COARSER**level
                across, along = (int(np.clip(np.ceil(length / size), 1, MOST_TEXELS)) for length in lengths)
                levels.append(Texels(shape, across, along, first, _areas(shape, across, along), False))
                first += levels[-1].count
        result[index] = levels
    return result


def _extent(shape: Shape, eye: FloatArray) -> tuple[tuple[float, float], float]:
    """Returns the lengths of the middle lines along u and v, and the distance from `eye` to their nearest point."""
    low, high = shape.v_range
    steps = np.linspace(0, 1, 65)
    lines = shape.at(steps, np.full(65, (low + high) / 2)), shape.at(np.full(65, 0.5), low + (high - low) * steps)
    u, v = (float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in lines)
    return (u, v), float(np.linalg.norm(np.concatenate(lines) - eye, axis=1).min())


def _areas(shape: Shape, across: int, along: int) -> FloatArray:
    """Returns the texel areas of one layer, from the area per du dv at the texel centres."""
    low, high = shape.v_range
    v, u = np.meshgrid(
        low + (high - low) * (np.arange(along) + 0.5) / along, (np.arange(across) + 0.5) / across, indexing="ij"
    )
    return np.maximum(shape.density(u.ravel(), v.ravel()) * (high - low) / (across * along), 1e-12)


def _laid_down(found: Iterable[tuple[int, Deposits]], texels: dict[int, list[Texels]], pixels: int) -> tuple[Csr, ...]:
    """Returns irradiance per unit drive, (texels, pixels) per channel; the channels share one pattern."""
    count = sum(grid.count for levels in texels.values() for grid in levels)
    places, powers, waiting = [np.zeros(0, np.int64)], [np.zeros((0, 3))], 0
    for level, batch in found:
        levels = texels[int(batch.surface[0])]
        grid = levels[min(level, len(levels) - 1)]
        texel, weight = grid.around(batch)
        irradiance = weight / grid.areas[(texel - grid.first) % grid.areas.size]
        places.append((texel * pixels + batch.pixel).ravel())
        powers.append((irradiance[..., None] * batch.flux).reshape(-1, 3))
        waiting += places[-1].size
        if waiting > SUMMED_AT_ONCE:
            place, power = summed(np.concatenate(places), np.concatenate(powers))
            places, powers, waiting = [place], [power], 0
    place, power = summed(np.concatenate(places), np.concatenate(powers))
    keep, factor = thinned(place // pixels, count, power, FAINT)
    place, power = place[keep], power[keep] * factor[place[keep] // pixels]
    starts, power = np.searchsorted(place, np.arange(count + 1) * pixels), np.maximum(power, NOTHING)
    return tuple(Csr((power[:, i], place % pixels, starts), shape=(count, pixels)) for i in range(3))
