"""Products of row maps with pictures: Σ weights · source, combined with a base."""

from typing import Any, Literal, get_args

import numpy as np

from counterlight.maps.row_map import RowMap, unpack
from counterlight.passes.drawing import CHANNELS, NOTHING, Array
from counterlight.passes.kernel import PLANE, Whole, inlined, kernel, prange, within

SHADER, COMPUTE_SHADER = "row_map.frag", "row_map.comp"
WORDS_SHADER, WORDS_COMPUTE_SHADER = "small_map.frag", "small_map.comp"  # shaders for maps in words of 4 bytes
# How a product is combined with its base: not at all, base + product, base − product, or clamped to 0..1 without a
# base. WEIGHED_RESIDUAL is w C ∘ (base − product) for maps in words (counterlight.maps.small_map), on a GPU only.
Combining = Literal["", "ADD_TO_BASE", "SUBTRACT_FROM_BASE", "CLAMP", "WEIGHED_RESIDUAL"]
REPLACE, ADD, SUBTRACT, CLAMP, _ = range(5)
COMBININGS: tuple[Combining, ...] = get_args(Combining)
STRETCH = np.uint64(64)  # entries of a row that are summed in float32; a sum in float64 alone takes twice as long
SHARES = 64  # parts of the rows of a product; each core takes one part at a time


class Rows:
    """A row map. Unsigned indices avoid Numba's wraparound check, 14 % of a product's time."""

    def __init__(self, packed: RowMap) -> None:
        rows = unpack(packed)
        self.output_shape, self.source_shape = packed.output_shape, packed.source_shape
        self._rows = rows.indptr.view(np.uint64), rows.indices.view(np.uint32), rows.weights

    def fill(self, source: Array, base: Array | None, combining: Combining, out: Array) -> None:
        """Multiply. source : (source height, source width, 3). base, out : (output height, output width, 3)."""
        shape, expected = source.shape, (*self.source_shape, CHANNELS)
        if shape != expected or (base is not None and base.shape != out.shape):
            raise ValueError(f"source of shape {shape}, the row map reads {expected} and adds {out.shape}")
        pixels, added, target = (
            each.reshape(-1, CHANNELS) for each in (source, NOTHING if base is None else base, out)
        )
        product(*self._rows, pixels, added, COMBININGS.index(combining), target)


@inlined
def summed(first: Any, end: Any, indices: Whole, weights: Array, source: Array) -> Any:
    """Return Σ weights[k] source[indices[k]] of the entries from `first` to `end`, in float32."""
    red, green, blue = np.float32(0), np.float32(0), np.float32(0)
    for k in range(first, end):
        at = indices[k]
        red += weights[k, 0] * source[at, 0]
        green += weights[k, 1] * source[at, 1]
        blue += weights[k, 2] * source[at, 2]
    return red, green, blue


@inlined
def summed_long(first: Any, end: Any, indices: Whole, weights: Array, source: Array) -> Any:
    """Return the sum of `summed` for a long row: stretches of STRETCH entries, added in float64."""
    red, green, blue = 0.0, 0.0, 0.0
    for begin in range(first, end, STRETCH):
        r, g, b = summed(begin, min(begin + STRETCH, end), indices, weights, source)
        red, green, blue = red + np.float64(r), green + np.float64(g), blue + np.float64(b)
    return np.float32(red), np.float32(green), np.float32(blue)


@kernel(f"uint64[::1], uint32[::1], {PLANE}, {PLANE}, {PLANE}, int64, {PLANE}")
def product(
    indptr: Whole, indices: Whole, weights: Array, source: Array, base: Array, combine: Any, out: Array
) -> None:
    """Compute Σ_k weights[k] source[indices[k]] of every row (row_map), and combine it with `base`.

    source, base, out : (pixels, 3).

    Rows of at most STRETCH entries are summed in float32 alone, which rounds equally well and takes two thirds of the
    time.
    """
    rows = out.shape[0]
    for share in prange(SHARES):
        low, high = np.uint64(share * rows // SHARES), np.uint64((share + 1) * rows // SHARES)
        end = indptr[low]
        for row in range(low, high):
            first, end = end, indptr[row + np.uint64(1)]
            if end - first <= STRETCH:
                red, green, blue = summed(first, end, indices, weights, source)
            else:
                red, green, blue = summed_long(first, end, indices, weights, source)
            if combine == ADD:
                red, green, blue = base[row, 0] + red, base[row, 1] + green, base[row, 2] + blue
            elif combine == SUBTRACT:
                red, green, blue = base[row, 0] - red, base[row, 1] - green, base[row, 2] - blue
            elif combine == CLAMP:
                zero, one = np.float32(0), np.float32(1)
                red, green, blue = within(red, zero, one), within(green, zero, one), within(blue, zero, one)
            out[row, 0], out[row, 1], out[row, 2] = red, green, blue
