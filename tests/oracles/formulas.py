"""The passes as formulas in numpy: tests compare the compiled CPU functions of counterlight.passes with them.

Pictures are (row, column, channel), linear, row 0 at the top. Sums are in float64, so that a formula is more exact than
the pass. tone : (s, o), see content.py; adaptation.py computes it.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from counterlight.files.cube import Cube
from counterlight.maps.mixing import mixed, nearest, spread
from counterlight.maps.prior import Prior, pull
from counterlight.media.frames import PixelFormat
from counterlight.passes.colour import LUMINANCE, LUMINANCE_2020, Decoding
from counterlight.passes.moved import FADE, WHOLE
from counterlight.passes.pinned import MOST_TAPS, TINY
from counterlight.passes.planes_to_linear import LEAST, Rendition, Signal
from counterlight.pipeline.drift import positions, sampled
from counterlight.pipeline.shown_copies import reduced_boxes
from counterlight.raster import Region
from counterlight.unattended.watch_link import GRID

FloatArray = NDArray[np.floating]


def planes_to_linear(
    planes: Sequence[NDArray[np.generic]], pixels: PixelFormat, signal: Signal | None
) -> NDArray[np.float64]:
    """Convert decoded planes to linear RGB, upright (planes_to_linear.frag).

    planes : three (rows, stride) arrays.
    signal : None for linear radiance.
    """
    first, *others = (
        plane[: shape.height, : shape.width].astype(np.float64)
        for plane, shape in zip(planes, pixels.planes, strict=True)
    )
    if signal is None:
        linear = np.stack([first, *others], axis=-1)
    else:
        decoding, grid = signal.decoding, np.linspace(0, 1, signal.transfer.size)
        others = [_upsample(plane, first.shape, decoding) for plane in others]
        samples = (np.stack([first, *others], axis=-1) - decoding.black) / decoding.span
        codes = np.clip(samples @ decoding.to_rgb.T + signal.lift, 0, 1)
        codes = codes if signal.lut is None else tetrahedral(signal.lut, codes)
        linear = np.interp(codes, grid, signal.transfer)
        linear = linear if signal.rendition is None else on_screen(signal.rendition, linear)
    return np.rot90(linear, pixels.rotation // 90)


def tetrahedral(cube: Cube, codes: FloatArray) -> NDArray[np.float64]:
    """Apply a lookup table to codes (…, 3), by linear interpolation in six tetrahedra around each cell's grey diagonal.

    The path leads from the cell's darkest corner along the axes, largest share first, to the brightest corner.
    """
    last = len(cube.table) - 1
    position = last * np.clip((codes - cube.low) / (cube.high - cube.low), 0, 1)
    corner = np.minimum(position.astype(int), last - 1)
    shares = position - corner
    found = _sample(cube, corner)
    order = np.argsort(-shares, axis=-1)
    for rank in range(3):
        axis = order[..., rank : rank + 1]
        before, corner = _sample(cube, corner), corner + (np.arange(3) == axis)
        found = found + np.take_along_axis(shares, axis, -1) * (_sample(cube, corner) - before)
    return found


def _sample(cube: Cube, corner: NDArray[np.int64]) -> NDArray[np.float64]:
    return cube.table[corner[..., 2], corner[..., 1], corner[..., 0]].astype(np.float64)


def resample(picture: FloatArray, target: tuple[int, int], placement: tuple[int, int, int, int]) -> FloatArray:
    """Place a picture in a black target (height, width) (resample.frag, twice).

    placement : left, top, width, height.
    """
    left, top, width, height = placement
    across = resample_axis(picture, 1, target[1], left, width)
    return resample_axis(across, 0, target[0], top, height)


def resample_axis(picture: FloatArray, axis: int, length: int, origin: float, extent: float) -> FloatArray:
    """Resample a picture along one axis to `length` target pixels, with a tent filter.

    origin, extent : the picture covers origin … origin + extent of the target.
    """
    count = picture.shape[axis]
    scale = count / extent
    centre = (np.arange(length) + 0.5 - origin) * scale
    radius = max(scale, 1.0)
    weights = np.maximum(0, 1 - np.abs(np.arange(count) + 0.5 - centre[:, None]) / radius)
    weights[(centre <= 0) | (centre >= count)] = 0
    total = weights.sum(axis=1, keepdims=True)
    weights = np.divide(weights, total, out=np.zeros_like(weights), where=total > 0)
    return np.moveaxis(np.tensordot(weights, picture, axes=(1, axis)), 0, axis)


def pinned(
    picture: FloatArray,
    target: tuple[int, int],
    H: FloatArray,
    across: FloatArray | None = None,
    down: FloatArray | None = None,
) -> FloatArray:
    """Place a picture by a projective map, with black around it (pinned.frag).

    H : (3, 3). Target position -> picture position, in pixels (counterlight.pipeline.placement.homography).
    across, down : screen positions of the target's pixels, which H then maps (counterlight.screen.axes); None without a
        screen.

    The filter is a tent along each axis of the picture, as wide as a target pixel appears there. Its half width is
    √(∂x² + ∂y²) of the map's derivatives, at least one pixel, so an upright placement matches `resample`. An edge pixel
    is weighted by its covered part, estimated from the distance to the edge.
    """
    y, x = np.mgrid[: target[0], : target[1]] + 0.5
    slopes = np.broadcast_to(np.eye(2)[:, :, None, None], (2, 2, *target))
    if across is not None and down is not None:
        x, y = across[..., 0].astype(np.float64), down[..., 0].astype(np.float64)
        slopes = np.moveaxis(np.stack([across[..., 1:], down[..., 1:]]), -1, 1).astype(np.float64)
    u, v, w = np.einsum("ij,jyx->iyx", H, np.stack([x, y, np.ones_like(x)]))
    ahead = (w > 0) & slopes.any(axis=(0, 1))
    w = np.where(ahead, w, 1)
    u, v = u / w, v / w
    reach_u, reach_v = (
        np.maximum(np.hypot(*(bend[0] * slopes[0] + bend[1] * slopes[1])) / w, TINY)
        for bend in (
            (H[0, 0] - u * H[2, 0], H[0, 1] - u * H[2, 1]),
            (H[1, 0] - v * H[2, 0], H[1, 1] - v * H[2, 1]),
        )
    )
    height, width = picture.shape[:2]
    inside = np.minimum(np.minimum(u, width - u) / reach_u, np.minimum(v, height - v) / reach_v)
    cover = np.where(ahead, np.clip(inside + 0.5, 0, 1), 0)
    shown = cover > 0
    sums, total = np.zeros((np.count_nonzero(shown), 3)), np.zeros((np.count_nonzero(shown), 1))
    columns = list(_taps(u[shown], np.maximum(reach_u[shown], 1), width))
    for row, share in _taps(v[shown], np.maximum(reach_v[shown], 1), height):
        for column, weight in columns:
            weight = (share * weight)[:, None]
            sums += weight * picture[row, column]
            total += weight
    result = np.zeros((*target, 3))
    result[shown] = cover[shown][:, None] * np.divide(sums, total, out=np.zeros_like(sums), where=total > 0)
    return result


def _taps(centre: FloatArray, radius: FloatArray, count: int) -> Iterator[tuple[NDArray[np.int64], FloatArray]]:
    """Yield every filter's first tap with its weight, then the second, and so on; past a filter's end, weight 0."""
    step = np.maximum(np.ceil(2 * radius / MOST_TAPS), 1)
    tap = np.maximum(np.ceil(centre - radius - 0.5), 0)
    last = np.minimum(np.floor(centre + radius - 0.5), count - 1)
    while np.any(tap <= last):
        weight = np.where(tap <= last, np.maximum(0, 1 - np.abs(tap + 0.5 - centre) / radius), 0)
        yield np.minimum(tap, count - 1).astype(int), weight
        tap = tap + step


def desired_light(
    picture: FloatArray,
    ambient: FloatArray | float,
    white: float,
    tone: FloatArray | tuple[float, float] = (1.0, 0.0),
    unit: float = 1.0,
    black_level: float = 0.0,
    full: FloatArray | None = None,
    *,
    clamp: bool = False,
    row_red: FloatArray | None = None,
    row_green: FloatArray | None = None,
    row_blue: FloatArray | None = None,
    squares: FloatArray | None = None,
    weights: FloatArray | float = 1.0,
) -> FloatArray:
    """Return the light that the projector must add: b = white (s u + o) weights − e (thesis eq. 5.1; desired.frag).

    With u = k + (1 − k) unit · picture.

    unit : share of white that a picture's 1 stands for.
    black_level : k, share of white that black stands for.
    full : T·1. Limits each pixel to its own range; otherwise its neighbours would brighten, and could not help.
    clamp : limit the result to 0..1, for a picture that is sent to the projector.
    row_red, row_green, row_blue : rows of a matrix per pixel, applied to b.
    squares : (9,). With rows and `full`, choose the light that the camera sees nearest to the target (maps/mixing.py).
    """
    scale, offset = np.ravel(tone)[:2]
    u = black_level + (1 - black_level) * (unit * picture)
    b = white * (scale * u + offset) * weights - ambient
    if row_red is not None and row_green is not None and row_blue is not None:
        rows = np.stack([row_red, row_green, row_blue], axis=-2)[..., :3]
        b = mixed(rows, b)
        if full is not None and squares is not None:
            b = nearest(b, full[..., :3], spread(rows, squares.reshape(3, 3)))
    if full is not None:
        b = np.clip(b, 0, full[..., :3])
    return np.asarray(np.clip(b, 0, 1) if clamp else b)


def combine(first: FloatArray, second: FloatArray, factor: float, *, clamp: bool = False) -> FloatArray:
    """Return one picture plus a multiple of another, limited to 0..1 if `clamp` (combine.frag)."""
    result = first + factor * second
    return np.clip(result, 0, 1) if clamp else result


def against_gradient(descent: FloatArray, y: FloatArray, **prior: FloatArray) -> FloatArray:
    """Return TᵀW(b − T y) − P y (refinement_step.frag with SLOPE)."""
    return descent - pull(y, **prior)


def refinement_step(
    descent: FloatArray,
    y: FloatArray,
    p: FloatArray,
    step_size: FloatArray,
    prior: Prior,
    momentum: float,
    over_relaxation: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the next p and y of one accelerated projected gradient step from y (refinement_step.frag).

    descent : TᵀW(b − T y).
    step_size : pixels with step size 0 stay dark.
    """
    slope = against_gradient(descent, y, **vars(prior))
    q = np.where(step_size > 0, np.clip(y + step_size * slope, 0, 1), 0)
    return q, q + momentum * (q - p) + over_relaxation * (q - y)


def _upsample(plane: FloatArray, size: tuple[int, ...], decoding: Decoding) -> NDArray[np.float64]:
    """Interpolate chroma at every luma pixel, bilinear, clamped at the borders."""
    result = np.asarray(plane, np.float64)
    for axis in (0, 1):
        position = np.arange(size[axis]) / decoding.subsampling[1 - axis] + decoding.chroma_offset[1 - axis]
        low = np.floor(position)
        share = np.expand_dims(position - low, 1 - axis)
        last = plane.shape[axis] - 1
        a = np.take(result, np.clip(low, 0, last).astype(int), axis)
        b = np.take(result, np.clip(low + 1, 0, last).astype(int), axis)
        result = a + (b - a) * share
    return result


def blend(now: FloatArray, before: FloatArray, weight: float, gain: float = 1.0) -> FloatArray:
    """Return (1 − weight) now + weight · gain · before (blend.frag)."""
    return np.asarray((1 - weight) * now + weight * gain * before)


def on_screen(rendition: Rendition, light: FloatArray) -> NDArray[np.float64]:
    """Convert light (…, 3), 1 at the medium's peak, to light with 1 at white."""
    if rendition.ootf:
        luminance = np.maximum(light @ LUMINANCE_2020, LEAST)
        light = light * luminance[..., None] ** rendition.ootf
    brightest = light.max(axis=-1, keepdims=True)
    position = np.clip(brightest / rendition.top, 0, 1) ** 0.25
    gain = np.interp(position, np.linspace(0, 1, rendition.gain.size), rendition.gain)
    light = light * gain * rendition.top / np.maximum(brightest, rendition.top)
    return within_gamut(light @ rendition.matrix.T)


def within_gamut(linear_rgb: FloatArray) -> NDArray[np.float64]:
    """Mix each colour with the grey of its luminance, as little as brings every channel into 0..1."""
    grey = np.clip(linear_rgb @ LUMINANCE, 0, 1)[..., None]
    least, most = linear_rgb.min(axis=-1, keepdims=True), linear_rgb.max(axis=-1, keepdims=True)
    low = np.where(least < 0, grey / np.maximum(grey - least, LEAST), 1)
    high = np.where(most > 1, (1 - grey) / np.maximum(most - grey, LEAST), 1)
    return np.asarray(np.clip(grey + np.minimum(low, high) * (linear_rgb - grey), 0, 1))


def moved(drive: FloatArray, projectors: FloatArray) -> FloatArray:
    """Return a drive (height, width, 3) as it is shown (moved.frag). `projectors` comes from `Drift.table`."""
    shown = np.zeros(drive.shape)
    for rows in np.asarray(projectors, np.float64):
        part = Region(*(int(value) for value in (*rows[3, :2], *rows[4, :2]))).part
        picture = drive[part]
        height, width = picture.shape[:2]
        at, ahead = positions(rows[:3], (height, width))
        depth = np.minimum(at, (width, height) - at)
        lands = ahead * np.clip(1 + (depth + WHOLE) / FADE, 0, 1).prod(axis=2)
        landed = lands[..., None] * sampled(picture, at.reshape(-1, 2)).reshape(picture.shape)
        shown[part] = np.clip(landed / rows[5], 0, 1)
    return shown


def reduced(drive: NDArray[np.floating], regions: Sequence[Region], factor: int) -> NDArray[np.float16]:
    """Return means over factor × factor pixels of each projector's picture, next to each other.

    drive : (height, width, 3). Linear drive of the raster.
    """
    parts = [_means(drive[region.part], factor) for region in regions]
    whole = np.zeros((max(map(len, parts)), sum(part.shape[1] for part in parts), 3), np.float16)
    for part, box in zip(parts, reduced_boxes(regions, factor), strict=True):
        whole[box.part] = part
    return whole


def grid_means(picture: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return means over a grid of GRID cells, 0 in cells without pixels: (height, width, 3) -> (*GRID, 3)."""
    edges = [np.arange(cells + 1) * size // cells for size, cells in zip(picture.shape, GRID, strict=False)]
    return np.asarray(_over(picture.astype(np.float32), *edges), np.float32)


def _means(picture: NDArray[np.floating], factor: int) -> NDArray[np.float32]:
    edges = [np.append(np.arange(0, size, factor), size) for size in picture.shape[:2]]
    return _over(picture.astype(np.float32), *edges)


def _over(picture: NDArray[np.float32], rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float32]:
    total = np.pad(picture.cumsum(axis=0, dtype=np.float64).cumsum(axis=1), ((1, 0), (1, 0), (0, 0)))
    sums = np.diff(np.diff(total[rows][:, columns], axis=0), axis=1)
    counts = np.diff(rows)[:, None, None] * np.diff(columns)[:, None]
    return np.asarray(sums / np.maximum(counts, 1), np.float32)
