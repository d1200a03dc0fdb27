"""Shares of each camera pixel's light by the way that it came.

Light is *bounced* if it comes from everywhere: far light, and light that is strewn over near light. It is *bent* by
glass or a mirror if it comes from where straight light cannot (bending.py), in many spots, or strewn from a small part.
It is *scattered* below a surface if its footprint is wide and differs between colours, or has long tails. (Red travels
further than blue in wax and skin, and some light travels far.) It is *blurred* by a lens if its footprint is merely
wide. The rest is straight.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.calibration import Calibration
from counterlight.raster import Shape
from counterlight.tools.transport.transport import Transport, luminance
from counterlight.tools.ways.bending import LEAST_PX, Lines
from counterlight.tools.ways.footprints import PERIODS, Footprints, footprints

# percentile of bright pixels; footprints of pixels below FAINTEST of it are noise
BRIGHT_PERCENTILE, FAINTEST = 95, 0.02
TOLD = 0.1  # a way of light is reported for a pixel from this share of the pixel's light
WIDE, FAR_WIDE = 0.4, 1.0  # pixels² beyond the size of the pixels: distinct from noise, visible as blur
COLOURED = 0.35  # share of the spread: minimal difference between channels
TAILS = 2.6  # between 2 of a normal spot and 3.3 of a planar exponential spot
FILLED = 0.25  # share of a full spot's entries; wax has 0.4 and more, blur 0.9, many spots have fewer
EVERYWHERE = 0.01  # share of the projector's pixels: strewn light from fewer pixels comes from glass or a coat
OFF_PX = 5 * LEAST_PX  # a further spot that is nearer to its line is the other side of an edge


@dataclass(frozen=True)
class Way:
    """A way of light: a name for JSON, the legend's words and its colour (8-bit sRGB)."""

    name: str
    words: str
    colour: tuple[int, int, int]


STRAIGHT = Way("straight", "straight from the projector", (205, 205, 205))
BENT = Way("bent", "by glass or a mirror: seen through it, or lit", (70, 130, 220))
SCATTERED = Way("scattered", "scattered below the surface: wax, skin, marble, thick paint", (230, 160, 60))
BOUNCED = Way("bounced", "interreflecting: bounced off other surfaces first", (200, 70, 60))
BLURRED = Way("blurred", "out of focus", (110, 170, 100))
DARK = Way("dark", "too little light to say", (40, 40, 40))
WAYS = BENT, SCATTERED, BOUNCED, BLURRED


@dataclass(frozen=True)
class Ways:
    """Shares of each camera pixel's light, T·1.

    shares : (WAYS, camera height, camera width), 0 to 1. The rest is straight.
    lit : (camera height, camera width). Where there is enough light to find the way.
    radius : (camera height, camera width). Root mean square radius of the main footprint, projector pixels.
    contrast : (camera height, camera width, PERIODS). Remaining contrast of stripes with these periods.
    bounced : (camera height, camera width, 3). Radiance of bounced light under a white picture.
    """

    shares: FloatArray
    lit: BoolArray
    radius: FloatArray
    contrast: FloatArray
    bounced: FloatArray

    @property
    def flags(self) -> BoolArray:
        """Ways that brought a tenth of a pixel's light or more, (WAYS, camera height, camera width)."""
        return np.asarray((self.shares >= TOLD) & self.lit)

    @property
    def first(self) -> IntArray:
        """(camera height, camera width): 0 for straight light, 1 + the index of the largest way, −1 for dark pixels."""
        found = np.where(self.flags.any(axis=0), 1 + np.argmax(self.shares, axis=0), 0)
        return np.where(self.lit, found, -1)

    def picture(self) -> NDArray[np.uint8]:
        """Returns each pixel in the colour of its largest way, or of straight light."""
        return np.array([each.colour for each in (STRAIGHT, *WAYS, DARK)], np.uint8)[self.first]

    def to_json(self) -> dict[str, dict[str, float]]:
        """Returns for each way: pixels drawn in its colour, all pixels whose light took it, and its light's share."""
        counts = np.bincount(self.first.ravel() % (2 + len(WAYS)), minlength=2 + len(WAYS))
        lit = max(int(self.lit.sum()), 1)
        shares = [float(each[self.lit].sum() / lit) for each in self.shares]
        every = [int(each.sum()) for each in self.flags]
        straight = int((self.lit & (self.shares.sum(axis=0) <= 1 - TOLD)).sum())
        rows = zip(
            (STRAIGHT, *WAYS, DARK),
            counts,
            (straight, *every, counts[-1]),
            (1 - sum(shares), *shares, 0.0),
            strict=True,
        )
        return {way.name: {"shown": int(a), "all": int(b), "share": share} for way, a, b, share in rows}

    def finest(self, contrast: float = 0.5) -> FloatArray:
        """Returns the period of the finest stripes that keep `contrast`, in projector pixels; infinite if none do."""
        prints = self.contrast >= contrast
        return np.where(prints.any(axis=2), np.array(PERIODS, np.float64)[np.argmax(prints, axis=2)], np.inf)


def ways_of(calibration: Calibration, transport: Transport) -> Ways:
    """Returns the ways of light, over every camera's pixels in every projector's light.

    transport : T of `calibration`. Where several projectors light a pixel, each contributes its share of the light.
    """
    shape, pixels = calibration.camera.shape, np.arange(calibration.camera.pixels).reshape(calibration.camera.shape)
    seen = _Sums.dark(shape)
    for view in calibration.views:
        rows = pixels[view]
        for region in calibration.regions:
            prints = footprints(transport, rows.ravel(), calibration.projector.width, region)
            seen.add(view, _Seen(prints, (rows.shape[0], rows.shape[1]), region.width * region.height))
    if transport.far is not None:
        seen.add_far(transport.far.apply(np.ones((transport.shape[1], 3))).reshape(*shape, 3))
    return seen.shares()


class _Seen:
    """One camera's pixels in one projector's light; pictures are (camera height, camera width, …)."""

    def __init__(self, prints: Footprints, camera: Shape, projector_pixels: int) -> None:
        self.light, self._main, self._second = (
            each.reshape(camera) for each in (prints.light, prints.main, prints.second)
        )
        self.strewn, self.spread = (each.reshape(*camera, 3) for each in (prints.strewn, prints.spread))
        self.contrast = prints.contrast.reshape(*camera, len(PERIODS))
        self._middle, self._second_middle = (each.reshape(*camera, 2) for each in (prints.middle, prints.second_middle))
        self._tails, self._count = prints.tails.reshape(camera), prints.count.reshape(camera)
        self._everywhere = prints.strewn_count.reshape(camera) > EVERYWHERE * projector_pixels
        self._lit = bright(self.light)

    def by_way(self) -> FloatArray:
        """Returns the light of each of WAYS, (WAYS, camera height, camera width)."""
        lines = Lines(self._middle, self._lit)
        scattered, blurred, parted = self._widened()
        bent = (lines.bent(self._middle) | parted) & ~scattered
        blurred, alone = blurred & ~bent, ~bent & ~scattered
        off_axis = alone & (np.abs(lines.distance(self._second_middle)) > OFF_PX)
        strewn = luminance(self.strewn.reshape(-1, 3)).reshape(self.light.shape)
        by_glass = np.where(off_axis, self._second, 0) + np.where(self._everywhere, 0, strewn)
        return np.stack(
            [
                np.where(bent, self.light, np.where(alone, by_glass, 0)),
                np.where(scattered, self._main + strewn, 0),
                np.where(alone & self._everywhere, strewn, 0),
                np.where(blurred, self._main, 0),
            ]
        )

    def _widened(self) -> tuple[BoolArray, BoolArray, BoolArray]:
        """Returns where footprints are wider than pixels: by scattering, by a lens, and by separate spots."""
        spread = np.stack([_median(each, self._lit) for each in np.moveaxis(self.spread, 2, 0)])
        mean = spread.mean(axis=0)
        excess = mean - self._of_pixels(self._lit)
        filled = self._count > FILLED * 2 * np.pi * self.spread.mean(axis=2)
        coloured = np.ptp(spread, axis=0) > COLOURED * np.maximum(excess, WIDE)
        tailed = (_median(self._tails, self._lit) > TAILS) & (excess > FAR_WIDE)
        wide, filled = self._lit & (excess > WIDE), most_around(filled)
        scattered = most_around(wide & filled & (coloured | tailed))
        return scattered, wide & filled & (excess > FAR_WIDE) & ~scattered, wide & ~filled & (excess > FAR_WIDE)

    def _of_pixels(self, lit: BoolArray) -> FloatArray:
        """Returns the part of the spread that comes from the sizes of the pixels alone."""
        steps = [_least_step(self._middle, lit, axis) for axis in (0, 1)]
        return (steps[0] + steps[1] + 2) / 12  # variance of a camera pixel and of a projector pixel, both squares


@dataclass
class _Sums:
    """Sums over cameras and projectors."""

    light: FloatArray
    by_way: FloatArray
    bounced: FloatArray
    near: FloatArray
    spread: FloatArray
    contrast: FloatArray

    @classmethod
    def dark(cls, shape: Shape) -> "_Sums":
        sizes = (shape, (len(WAYS), *shape), (*shape, 3), shape, shape, (*shape, len(PERIODS)))
        return cls(*map(np.zeros, sizes))

    def add(self, view: tuple[slice, slice], seen: _Seen) -> None:
        by_way = seen.by_way()
        self.by_way[:, *view] += by_way
        self.light[view] += seen.light
        self.near[view] += seen.light
        self.spread[view] += seen.light * seen.spread.mean(axis=2)
        self.contrast[view] += seen.light[..., None] * seen.contrast
        self.bounced[view] += seen.strewn * (by_way[WAYS.index(BOUNCED)] > 0)[..., None]

    def add_far(self, far: FloatArray) -> None:
        light = luminance(far.reshape(-1, 3)).reshape(self.light.shape)
        self.light += light
        self.by_way[WAYS.index(BOUNCED)] += light
        self.bounced += far

    def shares(self) -> Ways:
        lit, near = bright(self.light), np.maximum(self.near, np.finfo(float).tiny)
        shares = np.where(lit, self.by_way / np.maximum(self.light, np.finfo(float).tiny), 0)
        return Ways(shares, lit, np.sqrt(self.spread / near), self.contrast / near[..., None], self.bounced)


def bright(light: FloatArray) -> BoolArray:
    """Returns where there is enough light to find the way that it took."""
    if not light.any():
        return np.zeros(light.shape, bool)
    return np.asarray(light > FAINTEST * np.percentile(light[light > 0], BRIGHT_PERCENTILE))


def _median(values: FloatArray, lit: BoolArray) -> FloatArray:
    """Returns the median of each pixel and its neighbours, because single pixels lie on edges."""
    return np.asarray(ndimage.median_filter(np.where(lit, values, 0), 3, mode="nearest"))


def most_around(flags: BoolArray) -> BoolArray:
    """Returns the majority of each 3×3 neighbourhood."""
    return np.asarray(ndimage.uniform_filter(flags.astype(np.float64), 3, mode="nearest") > 0.5)


def _least_step(middle: FloatArray, lit: BoolArray, axis: int) -> FloatArray:
    """Returns squared distances, pixels², to the nearer of the two neighbouring middles along an axis.

    The nearer is taken because edges also make steps.
    """
    known = np.where(lit[..., None], middle, np.nan)
    steps = (np.diff(known, axis=axis) ** 2).sum(axis=2)
    ends = [(0, 0), (0, 0)]
    ends[axis] = (1, 1)
    wide = np.pad(steps, ends, constant_values=np.nan)
    before, after = (np.take(wide, range(start, start + lit.shape[axis]), axis) for start in (0, 1))
    return np.asarray(np.nan_to_num(np.fmin(before, after)))
