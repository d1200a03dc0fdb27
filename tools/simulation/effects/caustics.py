"""Caustics: projector light that reaches a surface by way of glass or coats, laid down on a light map (beams.py).

The map's texels lie over each surface's (u, v), a front and a back layer; on meshes without (u, v) the facets are the
texels. A deposit of flux goes to the four texels around it with bilinear weights, and the map is read with the same:
between lies irradiance per unit drive, texels × projector pixels. The finest texels are about half as wide as the
projector's pixels on the surface; beams that spread wide go to coarser ones, and the levels add up.
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

FINENESS = 2.0  # texels for a projector pixel's width
MOST_TEXELS = 2048  # an axis
SUMMED_AT_ONCE = 1 << 22
FAINT = 0.02  # of a texel's largest entry; smaller ones go, and the rest is scaled to keep the texel's light
NOTHING = 1e-30  # stands for 0, which scipy's products would leave out of one channel's pattern
Places = Samples | Deposits


@dataclass(frozen=True)
class Texels:
    """One level of a surface's share of the map: across along u, along v, from texel `first`; the back layer follows.

    areas : (across · along,) square metres.  by_facet : the texels are facets, across is their number.
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
        """Texels whose centres surround each place, and their bilinear weights, (4, n) each; (1, n) for facets."""
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
        """One of those texels for each place, drawn by its weight: on average over a pixel's samples the same light."""
        texel, weight = self.around(places)
        drawn = np.sum(np.cumsum(weight, axis=0)[:-1] < even_pairs(places.u.size)[:, 0], axis=0)
        return texel[drawn, np.arange(drawn.size)][None], np.ones((1, drawn.size))

    def deposits(self, surface: int, texel: IntArray, pixel: IntArray, irradiance: FloatArray) -> Deposits:
        """The flux that texels (n,), counted from 0, hold from projector pixels (n,)."""
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
    """Irradiance per unit drive, (texels, projector pixels) per channel, all of one pattern.

    texels : the levels of each matt surface, the finest first, by its index.
    """

    def __init__(self, scene: Scene, effects: "EffectsOn") -> None:
        self.texels = cut_into_texels(scene)
        pitches = {index: levels[0].pitch for index, levels in self.texels.items() if not levels[0].by_facet}
        self.light = _laid_down(deposits(scene, effects, pitches), self.texels, scene.projector.pixels)

    def deposits(self) -> list[Deposits]:
        """The light that the map holds, for the far light's cells: each texel's at its centre."""
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
        """What the map holds at samples, with no origin: it comes from more than one direction."""
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
        channels = [reading @ light for light in self.light]  # one pattern, so one order of entries
        sample = np.repeat(index, np.diff(channels[0].indptr))
        irradiance = np.stack([channel.data for channel in channels], axis=1)
        nowhere = np.broadcast_to(np.nan, (sample.size, 3))
        return Arrivals(sample, channels[0].indices.astype(np.int64), irradiance, nowhere, "caustics")


def light_map(scene: Scene, effects: "EffectsOn") -> LightMap:
    """The map of what the effects that are on send forward."""
    return LightMap(scene, effects)


def cut_into_texels(scene: Scene) -> dict[int, list[Texels]]:
    """The levels of every matt surface, by its index."""
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
    """Lengths of the middle lines along u and v, and the distance of their nearest point."""
    low, high = shape.v_range
    steps = np.linspace(0, 1, 65)
    lines = shape.at(steps, np.full(65, (low + high) / 2)), shape.at(np.full(65, 0.5), low + (high - low) * steps)
    u, v = (float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line in lines)
    return (u, v), float(np.linalg.norm(np.concatenate(lines) - eye, axis=1).min())


def _areas(shape: Shape, across: int, along: int) -> FloatArray:
    """Of one layer's texels, from the area per du dv at their centres."""
    low, high = shape.v_range
    v, u = np.meshgrid(
        low + (high - low) * (np.arange(along) + 0.5) / along, (np.arange(across) + 0.5) / across, indexing="ij"
    )
    return np.maximum(shape.density(u.ravel(), v.ravel()) * (high - low) / (across * along), 1e-12)


def _laid_down(found: Iterable[tuple[int, Deposits]], texels: dict[int, list[Texels]], pixels: int) -> tuple[Csr, ...]:
    """Irradiance per unit drive, (texels, pixels) per channel, all of one pattern."""
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
