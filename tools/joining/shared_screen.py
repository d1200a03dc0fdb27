"""Finds where the pixels of several cameras look on one screen, and their relative brightness, from T alone.

The screen is the view of one device, the first camera or the first projector, continued over places that only others
see. Cameras are placed one after the other; the next camera is the one that shares most with those before. Two cameras
that see one projector pixel see one place of the room. Knowledge about one camera's pixels (place, brightness) is
carried through its T to the projector pixels, and from there through the other camera's T.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.arrays import BoolArray, FloatArray, IntArray
from counterlight.calibration import Calibration
from counterlight.errors import InputError
from counterlight.files.picture_files import MAX_SIDE
from counterlight.memory import check
from counterlight.screen import Screen, parts_of, raster_of
from counterlight.tools.joining.smooth_field import smooth_field
from counterlight.tools.transport.transport import Csr, Transport, luminance_matrix

PIXEL_BYTES = 150  # memory per pixel of both rasters; 125 measured with ten projectors of 1920x1080
FEWEST = 24  # pixels that tie a camera: an affine map has 6 numbers, and some pixels are wrong
NOISY = 1.5  # in multiples of the camera pixels that one projector pixel covers
FARTHEST = 2.0  # largest distance from the screen, in screens; a pixel further out affects no picture
REACH = 3.0  # multiple of a footprint's usual radius; light further out took another way through the room
BRIGHT_PERCENTILE, FAINTEST = 95.0, 0.02  # below this share of the 95th percentile, light is too faint to locate
WHOLE = 0.98  # share of a footprint that must be known, so that its centre is right
MAD = 1.4826  # ratio of standard deviation to median absolute deviation of a normal distribution


@dataclass(frozen=True)
class Placed:
    """The placement of a camera on the screen.

    number : number of the camera, from 1.
    tied : number of its pixels that share light with cameras placed before.
    gain : (3,). Factor of its light.
    spread : usual relative distance of the pixels' own gains from `gain`; None if the light was not changed.
    """

    number: int
    tied: int
    gain: FloatArray
    spread: float | None = None

    def __str__(self) -> str:
        light = "its light as it is"
        if self.spread is not None:
            gain = " ".join(f"{each:.3f}" for each in self.gain)
            light = f"its light times {gain} (pixels differ by {100 * self.spread:.2g} %)"
        tied = f"{self.tied} of its pixels see what is on the screen already" if self.tied else "the screen is its view"
        return f"camera {self.number}: {tied}; {light}"


@dataclass(frozen=True)
class SharedRoom:
    """A room whose cameras share a screen, and the placements in order; for one camera, the room is unchanged."""

    calibration: Calibration
    transport: Transport
    placed: tuple[Placed, ...] = ()


def on_one_screen(
    calibration: Calibration,
    transport: Transport,
    cameras: tuple[tuple[int, int], ...],
    *,
    screen: str = "camera",
    keep_exposures: bool = False,
) -> SharedRoom:
    """Place cameras of a raster on one screen, and match their light where they overlap.

    calibration, transport : calibration and transport of the raster.
    cameras : (height, width) of each.
    screen : one of choices.SCREENS. The device whose view is the screen.
    keep_exposures : do not change the cameras' light.

    Raises InputError for a camera without ties to the others.
    """
    raster = calibration.projector
    check(
        PIXEL_BYTES * float(raster.pixels + calibration.camera.pixels),
        f"placing {len(cameras)} cameras that see projectors of {raster.width}x{raster.height} together",
        "use smaller projectors or cameras, or a machine with more",
    )
    found = _Placing(calibration, transport, cameras, keep_exposures=keep_exposures)
    if screen == "projector":
        found.begin_with_projector()
    else:
        found.begin_with_camera()
    while found.missing:
        found.place_next()
    return found.shared()


@dataclass(frozen=True)
class _View:
    """One camera's rows of T: luminance divided by the row's sum, so that paint does not move a footprint's centre.

    shape : (height, width).
    counts : (pixels,). Its mask.
    light : T·1, (pixels, 3).
    whole : (pixels,). Whether the footprint lies entirely within the picture.
    """

    T: Csr
    shape: tuple[int, int]
    counts: BoolArray
    light: FloatArray
    whole: BoolArray

    @classmethod
    def of(cls, rows: NDArray[np.int64], near: Csr, mask: BoolArray, light: FloatArray) -> "_View":
        """Make the view of one camera. rows : (height, width). Raster indices of its pixels."""
        inner = np.zeros(rows.shape, bool)
        inner[1:-1, 1:-1] = True
        flat = rows.ravel()
        T = Csr(near[flat]).astype(np.float64)
        total = np.asarray(T.sum(axis=1)).ravel()
        bright = total > FAINTEST * np.percentile(total[total > 0], BRIGHT_PERCENTILE) if total.any() else total > 0
        share = np.divide(1, total, out=np.zeros_like(total), where=bright)
        T = Csr(sparse.diags_array(share) @ T)
        T.eliminate_zeros()
        return cls(T, (rows.shape[0], rows.shape[1]), mask[flat], light[flat], inner.ravel())

    @property
    def centres(self) -> FloatArray:
        """x and y of every pixel's centre, (pixels, 2)."""
        y, x = np.mgrid[: self.shape[0], : self.shape[1]].reshape(2, -1) + 0.5
        return np.stack([x, y], axis=1)

    @property
    def step(self) -> float:
        """Camera pixels per side that one projector pixel covers."""
        lit = np.count_nonzero(np.diff(self.T.indptr))
        return float(np.sqrt(lit / max(np.unique(self.T.indices).size, 1)))


class _Placing:
    """What is known so far of the projectors' pixels: their places on the screen, and the brightness there."""

    def __init__(
        self,
        calibration: Calibration,
        transport: Transport,
        cameras: tuple[tuple[int, int], ...],
        *,
        keep_exposures: bool,
    ) -> None:
        self._calibration, self._transport, self._cameras = calibration, transport, cameras
        self._keep = keep_exposures
        pixels = np.arange(calibration.camera.pixels).reshape(calibration.camera.shape)
        self._rows, self._width = [pixels[part] for part in parts_of(cameras)], calibration.projector.width
        near, mask, light = luminance_matrix(transport.near), calibration.mask.ravel(), transport.composition()
        self._views = [_View.of(rows, near, mask, light) for rows in self._rows]
        count = calibration.projector.pixels
        self._place, self._placed_pixels = np.zeros((count, 2)), np.zeros(count, bool)
        self._light, self._bright_pixels = np.zeros((count, 3)), np.zeros(count, bool)
        self._positions: dict[int, FloatArray] = {}
        self._placed: list[Placed] = []

    @property
    def missing(self) -> list[int]:
        return [number for number in range(len(self._views)) if number not in self._positions]

    def begin_with_camera(self) -> None:
        self._keep_placed(0, self._views[0].centres, Placed(1, 0, np.ones(3)))

    def begin_with_projector(self) -> None:
        region = self._calibration.regions[0]
        y, x = np.mgrid[: region.height, : region.width].reshape(2, -1)
        pixels = y * self._width + x
        self._place[pixels], self._placed_pixels[pixels] = np.stack([x, y], axis=1) + 0.5, True

    def place_next(self) -> None:
        """Place the camera that shares most with those placed; raises InputError if none shares enough."""
        heard = {
            number: carried(self._views[number].T, self._width, self._place, self._placed_pixels)
            for number in self.missing
        }
        known = {number: each.known & self._views[number].counts for number, each in heard.items()}
        number = max(known, key=lambda each: int(known[each].sum()))
        view, tied = self._views[number], int(known[number].sum())
        if tied < FEWEST:
            raise InputError(_untied([each + 1 for each in self.missing], tied))
        values = heard[number].values.reshape(*view.shape, 2)
        field = smooth_field(values, known[number].reshape(view.shape), max(NOISY * view.step, NOISY))
        gain, spread = self._gain(view)
        self._keep_placed(number, field.reshape(-1, 2), Placed(number + 1, tied, gain, spread))

    def _gain(self, view: _View) -> tuple[FloatArray, float | None]:
        """Return the factor of the camera's light, (3,), and the spread of the pixels' own ratios."""
        expected = carried(view.T, self._width, self._light, self._bright_pixels)
        both = expected.known & view.counts & (view.light > 0).all(axis=1) & (expected.values > 0).all(axis=1)
        if self._keep or np.count_nonzero(both) < FEWEST:
            return np.ones(3), None
        ratios = np.log(expected.values[both] / view.light[both])
        middle = np.median(ratios, axis=0)
        return np.exp(middle), float(MAD * np.median(np.abs(ratios - middle)))

    def _keep_placed(self, number: int, positions: FloatArray, placed: Placed) -> None:
        """Store a camera's placement, and pass its places and brightness to projector pixels that had none."""
        view = self._views[number]
        self._positions[number] = positions
        self._placed.append(placed)
        passed_on = carried(
            Csr(view.T.T), view.shape[1], np.concatenate([positions, placed.gain * view.light], axis=1), view.whole
        )
        for values, known, own in (
            (self._place, self._placed_pixels, passed_on.values[:, :2]),
            (self._light, self._bright_pixels, passed_on.values[:, 2:]),
        ):
            new = passed_on.known & ~known
            values[new], known[new] = own[new], True

    def shared(self) -> SharedRoom:
        """Return the room after all cameras are placed."""
        raster = raster_of(self._cameras)
        positions, gains = np.zeros((raster[0] * raster[1], 2)), np.ones((raster[0] * raster[1], 3))
        for placed in self._placed:
            rows = self._rows[placed.number - 1].ravel()
            positions[rows], gains[rows] = self._positions[placed.number - 1], placed.gain
        shape, positions = _framed(positions, self._calibration.mask.ravel())
        each = np.stack([placed.gain for placed in sorted(self._placed, key=lambda placed: placed.number)])
        screen = Screen(shape, self._cameras, positions.reshape(*raster, 2).astype(np.float32), each)
        calibration = brightened(self._calibration, gains)
        return SharedRoom(replace(calibration, screen=screen), self._transport.scaled(gains), tuple(self._placed))


def brightened(calibration: Calibration, gains: FloatArray) -> Calibration:
    picture = gains.reshape(*calibration.camera.shape, 3).astype(np.float32)
    primaries = calibration.primaries
    return replace(
        calibration,
        ambient=calibration.ambient * picture,
        primaries=None if primaries is None else primaries * picture,
    )


def _framed(positions: FloatArray, counts: BoolArray) -> tuple[tuple[int, int], FloatArray]:
    """Return the screen's (height, width), around all pixels that count, and positions from its upper left."""
    low, high = np.floor(positions[counts].min(axis=0)), np.ceil(positions[counts].max(axis=0))
    size = np.maximum(high - low, 2).astype(int)
    if size.max() > MAX_SIDE:
        raise InputError(
            f"the screen would be {size[0]}x{size[1]} pixels, at most {MAX_SIDE} a side are: cameras see the wall at "
            "scales that are too different; begin with the one that stands nearest to the others, or --screen projector"
        )
    return (int(size[1]), int(size[0])), np.clip(positions - low, -FARTHEST * size, (1 + FARTHEST) * size)


def _untied(numbers: list[int], most: int) -> str:
    named = ", ".join(map(str, numbers))
    return (
        f"camera{'s' * (len(numbers) > 1)} {named}: {most} pixels see projector pixels that the others see, expected "
        f"at least {FEWEST}; let views overlap, add a camera between them, or take --screen projector if one projector "
        "lights what all see"
    )


@dataclass(frozen=True)
class Carried:
    """Values carried through T.

    values : (receivers, n). Undefined where not `known`.
    known : (receivers,) bool.
    """

    values: FloatArray
    known: BoolArray


def carried(T: Csr, width: int, values: FloatArray, known: BoolArray) -> Carried:
    """Return the mean over each receiver's main footprint, weighted by light.

    The main footprint lies around its centre, found from its brightest entry; glass and mirrors add others.

    T : (receivers, givers). Luminance.
    width : width of the givers' picture.
    values : (givers, n).
    known : (givers,).
    """
    count = T.shape[0]
    rows = np.repeat(np.arange(count), np.diff(T.indptr))
    light, place = T.data.astype(np.float64), np.stack(np.divmod(T.indices.astype(np.int64), width), axis=1)
    inside = _main_footprint(rows, place, light, count)
    rows, given, light = rows[inside], T.indices[inside], light[inside]
    total = np.bincount(rows, light, count)
    known_light = np.where(known[given], light, 0)
    heard = np.bincount(rows, known_light, count)
    sums = np.stack(
        [np.bincount(rows, known_light * np.where(known, each, 0)[given], count) for each in values.T], axis=1
    )
    lit = total > FAINTEST * np.percentile(total[total > 0], BRIGHT_PERCENTILE) if total.any() else total > 0
    means = np.divide(sums, heard[:, None], out=np.zeros_like(sums), where=heard[:, None] > 0)
    return Carried(means, lit & (heard >= WHOLE * total))


def _main_footprint(rows: IntArray, place: IntArray, light: FloatArray, count: int) -> BoolArray:
    """Return which entries are near the brightest spot of their row, (entries,) bool."""
    most = np.zeros(count)
    np.maximum.at(most, rows, light)
    brightest = np.flatnonzero((light == most[rows]) & (light > 0))
    found, first = np.unique(rows[brightest], return_index=True)
    middle = np.zeros((count, 2))
    middle[found] = place[brightest[first]]
    away = _squared(place - middle[rows])
    usual = np.sqrt(np.bincount(rows, light * away, count)[found] / np.bincount(rows, light, count)[found])
    reach = 1 + REACH * float(np.median(usual)) if found.size else 1.0
    near = np.where(away <= reach**2, light, 0)
    total = np.bincount(rows, near, count)
    for axis in range(2):
        middle[:, axis] = np.divide(
            np.bincount(rows, near * place[:, axis], count), total, where=total > 0, out=middle[:, axis]
        )
    return np.asarray(_squared(place - middle[rows]) <= reach**2)


def _squared(offsets: NDArray[np.floating]) -> FloatArray:
    return np.asarray((offsets**2).sum(axis=1))
