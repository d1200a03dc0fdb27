"""The CPU function of every shader pass, in numpy: tests compare the GPU and the compiled passes with these functions.

Each function names its shader. Pictures are (row, column, channel), linear, row 0 at the top. Sums are in float64 where
this costs little, so that the CPU function is the more exact version.

tone : (s, o), see content.py; adaptation.py computes it.
reach : (camera height, camera width, 4). Radiance of full drive; the fourth channel is 1 if a pixel is inside the mask
    and lit in every channel, else 0.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from counterlight.files.cube import Cube
from counterlight.maps.mixing import grey_reach, mixed, nearest, spread
from counterlight.maps.prior import Prior
from counterlight.maps.row_map import RowMap, unpack
from counterlight.media.frames import PixelFormat
from counterlight.pipeline.colour import Decoding
from counterlight.pipeline.signal import Signal
from counterlight.pipeline.views import (
    CLIP_FAINT,
    CLIP_SPAN,
    ERROR_SPAN,
    IMPOSSIBLE,
    MID_GREY,
    OVER,
    SLACK,
    UNCOUNTED,
    UNDER,
    error_colours,
)

FloatArray = NDArray[np.floating]
TINY = 1e-12  # pixels: smallest width to divide by
MOST_TAPS = 32  # along an axis; a wider filter takes every second or third sample, and so on


class PreparedRows:
    """A row map unpacked for repeated products: per channel Σ_k weight[k] · source[index[k]] (row_map.frag).

    Rows without entries give 0.
    """

    def __init__(self, packed: RowMap) -> None:
        self._rows = unpack(packed)
        self._shape, self._source_shape = packed.output_shape, packed.source_shape

    def apply(self, source: FloatArray) -> NDArray[np.float64]:
        """Multiply. source : (source height, source width, 3). Returns (output height, output width, 3)."""
        if source.shape[:2] != self._source_shape:
            raise ValueError(f"source of shape {source.shape[:2]}, the row map reads {self._source_shape}")
        return self._rows.apply(source.reshape(-1, 3)).reshape(*self._shape, 3)

    def apply_transpose(self, picture: FloatArray) -> NDArray[np.float64]:
        """Multiply a picture of the output's shape by the transpose; returns a picture of the source's shape."""
        return self._rows.apply_transpose(picture.reshape(-1, 3)).reshape(*self._source_shape, 3)


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
        linear = linear if signal.rendition is None else signal.rendition.on_screen(linear)
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
) -> FloatArray:
    """Return the light that the projector must add: b = white (s u + o) − e (thesis eq. 5.1; desired.frag).

    With u = k + (1 − k) unit · picture.

    unit : share of white that a picture's 1 stands for.
    black_level : k, share of white that black asks for.
    full : T·1. Limits each pixel to its own range; otherwise its neighbours would try to help in vain.
    clamp : limit the result to 0..1, for a picture that is sent to the projector.
    row_red, row_green, row_blue : rows of a matrix per pixel, applied to b.
    squares : (9,). With rows and `full`, choose the light that the camera sees nearest to the target (maps/mixing.py).
    """
    scale, offset = np.ravel(tone)[:2]
    u = black_level + (1 - black_level) * (unit * picture)
    b = white * (scale * u + offset) - ambient
    if row_red is not None and row_green is not None and row_blue is not None:
        rows = np.stack([row_red, row_green, row_blue], axis=-2)[..., :3]
        b = mixed(rows, b)
        if full is not None and squares is not None:
            b = nearest(b, full[..., :3], spread(rows, squares.reshape(3, 3)))
    if full is not None:
        b = np.clip(b, 0, full[..., :3])
    return np.asarray(np.clip(b, 0, 1) if clamp else b)


def mix(
    light: FloatArray, base: FloatArray, row_red: FloatArray, row_green: FloatArray, row_blue: FloatArray
) -> FloatArray:
    """Multiply the light by a matrix per pixel, and add a picture (mix.frag)."""
    return mixed(np.stack([row_red, row_green, row_blue], axis=-2), light) + base


def recolour(picture: FloatArray, matrix: FloatArray) -> FloatArray:
    """Multiply the light of all pixels by one matrix (recolour.frag). matrix : (9,), by columns."""
    return np.asarray(picture @ matrix.reshape(3, 3))


def combine(first: FloatArray, second: FloatArray, factor: float, *, clamp: bool = False) -> FloatArray:
    """Return one picture plus a multiple of another, limited to 0..1 if `clamp` (combine.frag)."""
    result = first + factor * second
    return np.clip(result, 0, 1) if clamp else result


def pull(p: FloatArray, damping: FloatArray, right: FloatArray, down: FloatArray) -> FloatArray:
    """Return P p of a prior (player/maps/prior.py): η p + Σ ω (p − neighbour's)."""
    across, along = right[:, :-1] * np.diff(p, axis=1), down[:-1] * np.diff(p, axis=0)
    result = np.asarray(damping * p)
    result[:, :-1] -= across
    result[:, 1:] += across
    result[:-1] -= along
    result[1:] += along
    return result


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


def gap_terms(descent: FloatArray, p: FloatArray) -> FloatArray:
    """Return each pixel's share of the gap, max(g p, g (p − 1)), with the gradient g = −descent (gap.frag)."""
    return np.maximum(-descent * p, descent * (1 - p))


def weighted(picture: FloatArray, weights: FloatArray, *, squared: bool = False) -> FloatArray:
    """Return weights · picture, or weights · picture² (weighted.frag)."""
    return np.asarray((picture**2 if squared else picture) * weights)


def block_sum(picture: FloatArray, side: int) -> FloatArray:
    """Sum blocks of side × side pixels; blocks at the right and lower edge may be smaller (block_sum.frag)."""
    rows, columns = (np.arange(0, length, side) for length in picture.shape[:2])
    return np.asarray(np.add.reduceat(np.add.reduceat(picture, rows, axis=0), columns, axis=1))


def split(left: FloatArray, right: FloatArray, line: float) -> FloatArray:
    """Return the left half of one picture and the right half of another, with a line of light between (split.frag)."""
    middle = left.shape[1] // 2
    result = np.concatenate([left[:, :middle], right[:, middle:]], axis=1)
    result[:, middle] = line
    return result


def reach_of(
    seen: FloatArray,
    ambient: FloatArray,
    mask: NDArray[np.bool_],
    row_red: FloatArray | None = None,
    row_green: FloatArray | None = None,
    row_blue: FloatArray | None = None,
    *,
    above: bool = False,
) -> FloatArray:
    """Return the brightest grey that each primary allows a pixel, and which pixels count (reach.frag).

    seen : camera picture of full drive; with matrix rows, without ambient light.
    row_red, row_green, row_blue : rows of a matrix per pixel.
    above : return only the light above ambient.
    """
    if row_red is None or row_green is None or row_blue is None:
        return counted(seen - ambient if above else seen, mask & np.all(seen > ambient, axis=2))
    reach = grey_reach(np.stack([row_red, row_green, row_blue], axis=-2), seen, ambient)
    return counted(reach, mask & np.all(seen > 0, axis=2))


def counted(reach: FloatArray, lit: NDArray[np.bool_]) -> FloatArray:
    """Append a channel to the greys of `reach_of`: 1 for pixels that count."""
    return np.concatenate([reach, lit[..., None]], axis=2)


def error_map(
    seen: FloatArray, ambient: FloatArray, b: FloatArray, reach: FloatArray, white: float
) -> NDArray[np.float64]:
    """Colour the difference between predicted picture and target, of the worst channel (error_map.frag)."""
    error = (seen - ambient - b) / white
    rows, columns = np.indices(error.shape[:2])
    worst = error[rows, columns, np.argmax(np.abs(error), axis=2)]
    colours = error_colours()
    position = (np.clip(worst / ERROR_SPAN, -1, 1) + 1) / 2
    grid = np.linspace(0, 1, len(colours))
    light = np.stack([np.interp(position, grid, colours[:, i]) for i in range(3)], axis=-1)
    return np.asarray(white * np.where(reach[..., 3:] > 0, light, UNCOUNTED))


def impossible(reach: FloatArray, white: float) -> NDArray[np.float64]:
    """Colour camera pixels by what they cannot show (impossible.frag); the classes are in views.py."""
    short = np.stack(shortfalls(reach, white))
    return np.asarray(white * IMPOSSIBLE[np.where(short.any(axis=0), 1 + short.argmax(axis=0), 0)])


def shortfalls(reach: FloatArray, white: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return pixels that do not count, cannot reach mid grey, or cannot reach white: (height, width) each."""
    least, lit = reach[..., :3].min(axis=2) * (1 + SLACK), reach[..., 3] > 0
    return ~lit, lit & (least < MID_GREY * white), lit & (least < white)


def clipping(view: FloatArray, asked: FloatArray, most: FloatArray | None, white: float) -> NDArray[np.float64]:
    """Colour targets below 0 or above `most`, by the excess of the worst channel (clipping.frag).

    most : (height, width, 4), as `reach`; None for a limit of 1, with every pixel counted.
    white : light of the colours; excess is measured in shares of white.
    """
    most = np.ones(4) if most is None else most
    over = np.max(asked - most[..., :3], axis=2, keepdims=True) / white
    under = np.max(-asked, axis=2, keepdims=True) / white
    amount = np.where(most[..., 3:] > 0, np.maximum(np.maximum(over, under), 0), 0)
    weight = 0.5 * np.minimum(amount / CLIP_FAINT, 1) + 0.5 * np.minimum(amount / CLIP_SPAN, 1)
    colour = white * np.where(over >= under, OVER, UNDER)
    return np.asarray(view + weight * (colour - view))


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


def inverse(picture: FloatArray) -> FloatArray:
    """Return 1 / picture, or 0 where the picture is 0 (inverse.frag)."""
    return np.divide(1.0, picture, out=np.zeros_like(picture), where=picture > 0)
