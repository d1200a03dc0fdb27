"""The CPU twin of every shader pass, in numpy: what the GPU is checked against, and `--backend cpu`.

Each function names its shader; those behind player/picture.py have their twins in player/picture_reference.py. Pictures
are (row, column, channel), linear, row 0 at the top; sums are in float64 where it costs little, so that the twin is the
more exact of the two.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from counterlight.colour import Decoding
from counterlight.row_map import RowMap, unpack

FloatArray = NDArray[np.floating]


class PreparedRows:
    """A row map unpacked for repeated products: per channel Σ_k weight[k] · source[index[k]] (row_map.frag).

    Rows without entries give 0.
    """

    def __init__(self, packed: RowMap) -> None:
        self._rows = unpack(packed)
        self._shape, self._source_shape = packed.output_shape, packed.source_shape

    def apply(self, source: FloatArray) -> NDArray[np.float64]:
        """source : (source height, source width, 3).  Returns (output height, output width, 3)."""
        if source.shape[:2] != self._source_shape:
            raise ValueError(f"source of shape {source.shape[:2]}, the row map reads {self._source_shape}")
        return self._rows.apply(source.reshape(-1, 3)).reshape(*self._shape, 3)

    def apply_transpose(self, picture: FloatArray) -> NDArray[np.float64]:
        """From a picture of the output's shape to one of the source's."""
        return self._rows.apply_transpose(picture.reshape(-1, 3)).reshape(*self._source_shape, 3)


def planes_to_linear(
    planes: Sequence[NDArray[np.generic]],
    size: tuple[int, int],
    chroma_size: tuple[int, int],
    decoding: Decoding | None,
    transfer: FloatArray,
    rotation: int,
    lift: float = 0.0,
) -> NDArray[np.float64]:
    """Decoded planes -> linear RGB, upright (planes_to_linear.frag).

    planes : three (rows, stride).  size, chroma_size : (height, width) in use.  decoding : None for linear radiance.
    transfer : (samples,) linear light over the code value 0..1.  rotation : degrees counter-clockwise.
    lift : added to every code value.
    """
    first = planes[0][: size[0], : size[1]].astype(np.float64)
    others = [plane[: chroma_size[0], : chroma_size[1]].astype(np.float64) for plane in planes[1:]]
    if decoding is None:
        linear = np.stack([first, *others], axis=-1)
    else:
        others = [_upsample(plane, size, decoding) for plane in others]
        samples = (np.stack([first, *others], axis=-1) - decoding.black) / decoding.span
        codes = np.clip(samples @ decoding.to_rgb.T + lift, 0, 1)
        linear = np.interp(codes, np.linspace(0, 1, transfer.size), transfer)
    return np.rot90(linear, rotation // 90)


def resample(picture: FloatArray, target: tuple[int, int], placement: tuple[int, int, int, int]) -> FloatArray:
    """Place a picture in a black target (height, width). Placement: left, top, width, height (resample.frag, twice)."""
    left, top, width, height = placement
    across = resample_axis(picture, 1, target[1], left, width)
    return resample_axis(across, 0, target[0], top, height)


def resample_axis(picture: FloatArray, axis: int, length: int, origin: float, extent: float) -> FloatArray:
    """Tent-filter a picture along one axis into `length` target pixels, of which it covers origin … origin + extent."""
    count = picture.shape[axis]
    scale = count / extent
    centre = (np.arange(length) + 0.5 - origin) * scale
    radius = max(scale, 1.0)
    weights = np.maximum(0, 1 - np.abs(np.arange(count) + 0.5 - centre[:, None]) / radius)
    weights[(centre <= 0) | (centre >= count)] = 0
    total = weights.sum(axis=1, keepdims=True)
    weights = np.divide(weights, total, out=np.zeros_like(weights), where=total > 0)
    return np.moveaxis(np.tensordot(weights, picture, axes=(1, axis)), 0, axis)


def combine(first: FloatArray, second: FloatArray, factor: float, *, clamp: bool = False) -> FloatArray:
    """One picture plus a multiple of another, limited to 0..1 if `clamp` (combine.frag)."""
    result = first + factor * second
    return np.clip(result, 0, 1) if clamp else result


def refinement_step(
    descent: FloatArray,
    y: FloatArray,
    p: FloatArray,
    step_size: FloatArray,
    momentum: float,
    over_relaxation: float,
) -> tuple[FloatArray, FloatArray]:
    """One accelerated projected gradient step from y, Tᵀ(b − T y) given; the next p and y (refinement_step.frag).

    A pixel whose step size is 0 stays dark.
    """
    q = np.where(step_size > 0, np.clip(y + step_size * descent, 0, 1), 0)
    return q, q + momentum * (q - p) + over_relaxation * (q - y)


def gap_terms(descent: FloatArray, p: FloatArray) -> FloatArray:
    """Each pixel's share of the gap, max(g p, g (p − 1)), of the gradient g = −descent (gap.frag)."""
    return np.maximum(-descent * p, descent * (1 - p))


def squared_error(residual: FloatArray, mask: NDArray[np.bool_]) -> FloatArray:
    """residual² inside the mask, 0 outside (squared_error.frag)."""
    return np.where(mask[..., None], residual**2, 0)


def block_sum(picture: FloatArray, side: int) -> FloatArray:
    """The sum of each block of side × side pixels, smaller at the right and lower edge (block_sum.frag)."""
    rows, columns = (np.arange(0, length, side) for length in picture.shape[:2])
    return np.asarray(np.add.reduceat(np.add.reduceat(picture, rows, axis=0), columns, axis=1))


def split(left: FloatArray, right: FloatArray, line: float) -> FloatArray:
    """The left half of one picture, the right half of the other, a line of light `line` between (split.frag)."""
    middle = left.shape[1] // 2
    result = np.concatenate([left[:, :middle], right[:, middle:]], axis=1)
    result[:, middle] = line
    return result


def encode(
    light: FloatArray, inverse_response: FloatArray, scale: float = 1.0, dither: str = "none", frame: int = 0
) -> NDArray[np.uint8]:
    """Linear light -> 8-bit code values (encode.frag).

    inverse_response : (samples, 3) code values over √light 0..1.  scale : light of a white pixel.
    dither : "ordered", "noise" or "none".
    """
    grid = np.linspace(0, 1, len(inverse_response))
    root = np.sqrt(np.clip(light / scale, 0, 1))
    codes = np.stack([np.interp(root[..., i], grid, inverse_response[:, i]) for i in range(3)], axis=-1)
    height, width = light.shape[:2]
    threshold: float | NDArray[np.float64] = 0.5
    if dither != "none":
        threshold = _bayer(height, width) if dither == "ordered" else _noise(height, width, frame)
    return np.asarray(np.floor(np.minimum(codes * 255 + threshold, 255)), np.uint8)


def _upsample(plane: FloatArray, size: tuple[int, int], decoding: Decoding) -> NDArray[np.float64]:
    """Chroma at every luma pixel, bilinear between samples, clamped at the borders."""
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


def _bayer(height: int, width: int) -> NDArray[np.float64]:
    y, x = np.mgrid[:height, :width]
    x ^= y
    rank = np.zeros((height, width), np.int64)
    for bit in range(3):
        rank = (rank << 2) | (((x >> bit) & 1) << 1) | ((y >> bit) & 1)
    return ((rank + 0.5) / 64)[..., None]


def _noise(height: int, width: int, frame: int) -> NDArray[np.float64]:
    """Uniform thresholds from the PCG hash of pixel, channel and frame (Jarzynski and Olano 2020)."""
    y, x = np.mgrid[:height, :width].astype(np.uint32)
    seed = _scramble(x + _scramble(y + _scramble(np.full((1, 1), frame & 0xFFFFFFFF, np.uint32))))
    noise = np.stack([_scramble(seed + np.uint32(i)) for i in range(3)], axis=-1)
    return ((noise >> np.uint32(9)).astype(np.float64) + 0.5) / 8388608.0


def _scramble(v: NDArray[np.uint32]) -> NDArray[np.uint32]:
    v = v * np.uint32(747796405) + np.uint32(2891336453)
    v = ((v >> ((v >> np.uint32(28)) + np.uint32(4))) ^ v) * np.uint32(277803737)
    return (v >> np.uint32(22)) ^ v
