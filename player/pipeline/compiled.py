"""The passes of a frame compiled for the CPU by Numba: what cpu_renderer.py runs where reference.py says what is meant.

Pictures are (rows, columns, channels) float32, contiguous; each kernel fills `out` and allocates nothing but a row.
Rows are shared out among the cores, and every value is computed in one order by one of them, so that the bytes are the
same on every run and whatever the number of threads. Arithmetic is in float32, as the shaders'; long sums go on in
float64. Kernels hold Python's lock: two threads of ours, the show's and one that estimates, never share out loops at a
time, which would end the process where Numba has but its own queue of work for that.
"""

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numba
import numpy as np
from numba.core import event
from numba.core.sigutils import normalize_signature
from numpy.typing import NDArray

from counterlight.maps.mixing import SWEEPS
from counterlight.maps.products import kept
from counterlight.maps.unpacking import unpack_entries
from counterlight.pipeline.reference import TINY

Picture = NDArray[np.float32]
Whole = NDArray[np.integer]
REPLACE, ADD, SUBTRACT, CLAMP = range(4)  # how a product meets its base
STRETCH = 64  # entries of a row that are summed in float32; a sum all in float64 takes twice as long
SHARES = 64  # of the rows of a product, that cores take one by one
PICTURE, PLANE, LINE = "float32[:, :, ::1]", "float32[:, ::1]", "float32[::1]"

_UNPACKING = f"uint32[:, ::1], {PICTURE}, uint32[:, ::1], int64[::1], int32[::1], {PLANE}"
KERNELS: list[tuple[Any, tuple[str, ...]]] = [(unpack_entries, (_UNPACKING,))]


def kernel(*signatures: str) -> Callable[[Callable[..., None]], Any]:
    """Compiled on first use, or by `prepare`, and kept for the next start where a folder can be written for that."""
    options: dict[str, Any] = {"parallel": True, "error_model": "numpy"}

    def compiled(function: Callable[..., None]) -> Any:
        made = kept(**options)(function)
        KERNELS.append((made, signatures))
        return made

    return compiled


def prepare(compiling: Callable[[int], None] = lambda left: None) -> None:
    """Load every kernel that is kept, and compile the others.

    compiling : called before each compilation with the number of kernels that are left. Numba's own event says so: how
    long a kernel takes does not, for loading all of them takes a second as well, and longer on a busy machine.
    """
    wanted = [(made, signature) for made, signatures in KERNELS for signature in signatures]
    for number, (made, signature) in enumerate(wanted):
        # As text, it would be kept apart from what a call compiles.
        types, _ = normalize_signature(f"({signature})")  # type: ignore[no-untyped-call]
        compiles = _Compiles(partial(compiling, len(wanted) - number))
        with suppress(OSError), event.install_listener("numba:compile", compiles):  # OSError: compiled, disk full
            made.compile(types)


def is_kept() -> bool:
    """Whether there is a folder where kernels are kept for the next start."""
    return all(made.stats.cache_path is not None for made, _ in KERNELS)


class _Compiles(event.Listener):
    """Calls `started` when Numba compiles a function, and not when Numba loads it."""

    def __init__(self, started: Callable[[], None]) -> None:
        self._started = started

    def on_start(self, event: Any) -> None:
        self._started()

    def on_end(self, event: Any) -> None:
        """Nothing to do."""


def inlined(function: Callable[..., Any]) -> Any:
    """Part of the kernels that call it."""
    return numba.njit(inline="always", error_model="numpy")(function)


@inlined
def within(value: Any, low: Any, high: Any) -> Any:
    return min(max(value, low), high)


@inlined
def _between(first: Any, second: Any, share: Any) -> Any:
    return np.float32(first) + (np.float32(second) - np.float32(first)) * share


@inlined
def looked_up(table: Any, share: Any) -> Any:
    """Of (samples,) over 0..1, linear between them. Unsigned: nothing asks whether an index counts from the end."""
    at = share * np.float32(table.size - 1)
    low = np.uint32(min(np.int32(at), np.int32(table.size - 2)))
    return table[low] + (table[low + np.uint32(1)] - table[low]) * (at - np.float32(low))


@kernel(
    *(
        f"{plane}, {plane}, {plane}, uint32[:, ::1], {LINE}, uint32[:, ::1], {LINE}, {PLANE}, {LINE}, {LINE}, "
        f"int64, int64, int64, {PLANE}"
        for plane in ("uint8[:, ::1]", "uint16[:, ::1]")
    )
)
def decode(
    luma: Whole,
    blue: Whole,
    red: Whole,
    rows: Whole,
    down: Picture,
    columns: Whole,
    across: Picture,
    matrix: Picture,
    lift: Picture,
    transfer: Picture,
    start: int,
    right: int,
    below: int,
    out: Picture,
) -> None:
    """Codes -> linear light (planes_to_linear): table of clamp(matrix · (Y, Cb, Cr) + lift).

    rows, columns : (2, length), the chroma samples on either side of a pixel, the second's share in down and across.
    out : (pixels, 3) of the upright picture; start, right, below : where the first stored pixel stands there, and how
    many pixels on from one that on its right, and that below it, do.
    In passes over a row, each of which runs on several pixels at a time.
    """
    height, width = rows.shape[1], columns.shape[1]
    for y in numba.prange(height):
        blues, reds = np.empty(blue.shape[1], np.float32), np.empty(red.shape[1], np.float32)
        cb, cr, light = np.empty(width, np.float32), np.empty(width, np.float32), np.empty((3, width), np.float32)
        upper, lower, share = rows[0, y], rows[1, y], down[y]
        for x in range(blues.size):
            blues[x] = _between(blue[upper, x], blue[lower, x], share)
            reds[x] = _between(red[upper, x], red[lower, x], share)
        for x in range(width):
            first, second, share = columns[0, x], columns[1, x], across[x]
            cb[x], cr[x] = _between(blues[first], blues[second], share), _between(reds[first], reds[second], share)
        for i in range(3):
            of_luma, of_blue, of_red, more = matrix[i, 0], matrix[i, 1], matrix[i, 2], lift[i]
            for x in range(width):
                code = of_luma * np.float32(luma[y, x]) + of_blue * cb[x] + of_red * cr[x] + more
                light[i, x] = within(code, np.float32(0), np.float32(1))
            for x in range(width):
                light[i, x] = looked_up(transfer, light[i, x])
        for x in range(width):
            at = start + y * below + x * right
            out[at, 0], out[at, 1], out[at, 2] = light[0, x], light[1, x], light[2, x]


@kernel(f"{PICTURE}, int32[::1], {PLANE}, {PICTURE}")
def across(source: Picture, first: Whole, weights: Picture, out: Picture) -> None:
    """Filter along x (resample): pixel x of a row sums weights[x] times the source's pixels from first[x] on."""
    taps = weights.shape[1]
    for y in numba.prange(out.shape[0]):
        for x in range(out.shape[1]):
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            for k in range(taps):
                weight, at = weights[x, k], first[x] + k
                red += weight * source[y, at, 0]
                green += weight * source[y, at, 1]
                blue += weight * source[y, at, 2]
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = red, green, blue


@kernel(f"{PLANE}, int32[::1], {PLANE}, {PLANE}")
def down(source: Picture, first: Whole, weights: Picture, out: Picture) -> None:
    """Filter along y; source, out : (rows, values)."""
    for y in numba.prange(out.shape[0]):
        for i in range(out.shape[1]):
            out[y, i] = weights[y, 0] * source[first[y], i]
        for k in range(1, weights.shape[1]):
            if weights[y, k] != 0:
                for i in range(out.shape[1]):
                    out[y, i] += weights[y, k] * source[first[y] + k, i]


@kernel(f"{PICTURE}, float64[:, ::1], int64, {PICTURE}, {PICTURE}, {PICTURE}")
def pinned(
    source: Picture, H: NDArray[np.float64], most_taps: int, across: Picture, down: Picture, out: Picture
) -> None:
    """Place a picture by a projective map, black around it (pinned); across, down : of a screen, or without pixels."""
    height, width = source.shape[:2]
    on_screen = across.shape[0] > 0
    for y in numba.prange(out.shape[0]):
        for x in range(out.shape[1]):
            red, green, blue, total, cover = 0.0, 0.0, 0.0, 0.0, 0.0
            spot_x, spot_y, xx, xy, yx, yy = float(x), float(y), 1.0, 0.0, 0.0, 1.0
            if on_screen:
                spot_x, xx, xy = across[y, x, 0] - 0.5, across[y, x, 1], across[y, x, 2]
                spot_y, yx, yy = down[y, x, 0] - 0.5, down[y, x, 1], down[y, x, 2]
            u, v, w = projected(H, spot_x, spot_y)
            if w > 0 and (xx != 0 or xy != 0 or yx != 0 or yy != 0):
                a, b = H[0, 0] - u * H[2, 0], H[0, 1] - u * H[2, 1]
                reach_u = max(np.hypot(a * xx + b * yx, a * xy + b * yy) / w, TINY)
                a, b = H[1, 0] - v * H[2, 0], H[1, 1] - v * H[2, 1]
                reach_v = max(np.hypot(a * xx + b * yx, a * xy + b * yy) / w, TINY)
                cover = within(min(min(u, width - u) / reach_u, min(v, height - v) / reach_v) + 0.5, 0.0, 1.0)
            if cover > 0:
                first, last, every, wide = _taps(u, reach_u, width, most_taps)
                top, bottom, each, high = _taps(v, reach_v, height, most_taps)
                for row in range(top, bottom + 1, each):
                    share = max(0.0, 1 - abs(row + 0.5 - v) / high)
                    for column in range(first, last + 1, every):
                        weight = share * max(0.0, 1 - abs(column + 0.5 - u) / wide)
                        red += weight * source[row, column, 0]
                        green += weight * source[row, column, 1]
                        blue += weight * source[row, column, 2]
                        total += weight
            share = cover / total if total > 0 else 0.0
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = share * red, share * green, share * blue


@inlined
def projected(H: Any, x: Any, y: Any) -> Any:
    """Where the centre of a pixel lands, and the third component."""
    w = H[2, 0] * (x + 0.5) + H[2, 1] * (y + 0.5) + H[2, 2]
    u = H[0, 0] * (x + 0.5) + H[0, 1] * (y + 0.5) + H[0, 2]
    v = H[1, 0] * (x + 0.5) + H[1, 1] * (y + 0.5) + H[1, 2]
    return u / w, v / w, w


@inlined
def _taps(centre: Any, reach: Any, count: Any, most: Any) -> Any:
    """First and last sample of a tent, the step between them, and its radius."""
    radius = max(reach, 1.0)
    first, last = np.ceil(centre - radius - 0.5), np.floor(centre + radius - 0.5)
    step = max(np.ceil(2 * radius / most), 1.0)
    return np.int64(max(first, 0.0)), np.int64(min(last, count - 1.0)), np.int64(step), radius


@inlined
def _turned(row: Any, squares: Any) -> Any:
    """Q Qᵀ times a row of A."""
    return (
        squares[0] * row[0] + squares[1] * row[1] + squares[2] * row[2],
        squares[3] * row[0] + squares[4] * row[1] + squares[5] * row[2],
        squares[6] * row[0] + squares[7] * row[1] + squares[8] * row[2],
    )


@inlined
def _dot(first: Any, second: Any) -> Any:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


@inlined
def _more(light: Any, moved: Any, own: Any, most: Any) -> Any:
    """By how much a limit moves its primary beyond what it has done, over N's diagonal."""
    alone = light - own * moved
    return (within(alone, np.float32(0), most) - alone) / own - moved


@inlined
def _nearest(red: Any, green: Any, blue: Any, most: Any, rows: Any, squares: Any) -> Any:
    """See maps/mixing.py."""
    red_turned, green_turned = _turned(rows[0], squares), _turned(rows[1], squares)
    rr, rg, rb = _dot(rows[0], red_turned), _dot(rows[1], red_turned), _dot(rows[2], red_turned)
    gg, gb, bb = _dot(rows[1], green_turned), _dot(rows[2], green_turned), _dot(rows[2], _turned(rows[2], squares))
    of_red, of_green, of_blue = np.float32(0), np.float32(0), np.float32(0)
    for _ in range(SWEEPS):
        more = _more(red, of_red, rr, most[0])
        red, green, blue, of_red = red + rr * more, green + rg * more, blue + rb * more, of_red + more
        more = _more(green, of_green, gg, most[1])
        red, green, blue, of_green = red + rg * more, green + gg * more, blue + gb * more, of_green + more
        more = _more(blue, of_blue, bb, most[2])
        red, green, blue, of_blue = red + rb * more, green + gb * more, blue + bb * more, of_blue + more
    return red, green, blue


@kernel(
    f"{PICTURE}, {PICTURE}, float32, float32, {PICTURE}, {PICTURE}, {PICTURE}, boolean, {PICTURE}, {LINE}, {PICTURE}"
)
def desired(
    picture: Picture,
    ambient: Picture,
    gain: Any,
    offset: Any,
    row_red: Picture,
    row_green: Picture,
    row_blue: Picture,
    clamp: Any,
    full: Picture,
    squares: Picture,
    out: Picture,
) -> None:
    """b = gain · picture + offset − ambient (desired_light), taken through a matrix of each pixel, and limited.

    row_red, row_green, row_blue, full, squares : empty where there is none.
    """
    mixes, limits, makes_up = row_red.size > 0, full.size > 0, squares.size > 0
    zero, one = np.float32(0), np.float32(1)
    for y in numba.prange(out.shape[0]):
        for x in range(out.shape[1]):
            red = gain * picture[y, x, 0] + offset - ambient[y, x, 0]
            green = gain * picture[y, x, 1] + offset - ambient[y, x, 1]
            blue = gain * picture[y, x, 2] + offset - ambient[y, x, 2]
            if mixes:
                red, green, blue = (
                    row_red[y, x, 0] * red + row_red[y, x, 1] * green + row_red[y, x, 2] * blue,
                    row_green[y, x, 0] * red + row_green[y, x, 1] * green + row_green[y, x, 2] * blue,
                    row_blue[y, x, 0] * red + row_blue[y, x, 1] * green + row_blue[y, x, 2] * blue,
                )
                if makes_up and (
                    min(red, green, blue) < zero or red > full[y, x, 0] or green > full[y, x, 1] or blue > full[y, x, 2]
                ):
                    rows = row_red[y, x], row_green[y, x], row_blue[y, x]
                    red, green, blue = _nearest(red, green, blue, full[y, x], rows, squares)
            if limits:
                red = within(red, zero, full[y, x, 0])
                green = within(green, zero, full[y, x, 1])
                blue = within(blue, zero, full[y, x, 2])
            if clamp:
                red, green, blue = within(red, zero, one), within(green, zero, one), within(blue, zero, one)
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = red, green, blue


@inlined
def summed(first: Any, end: Any, indices: Whole, weights: Picture, source: Picture) -> Any:
    """Σ weights[k] source[indices[k]] of the entries from `first` to `end`, in float32."""
    red, green, blue = np.float32(0), np.float32(0), np.float32(0)
    for k in range(first, end):
        at = indices[k]
        red += weights[k, 0] * source[at, 0]
        green += weights[k, 1] * source[at, 1]
        blue += weights[k, 2] * source[at, 2]
    return red, green, blue


@inlined
def summed_long(first: Any, end: Any, indices: Whole, weights: Picture, source: Picture) -> Any:
    """The same in stretches, whose sums are added in float64."""
    red, green, blue = 0.0, 0.0, 0.0
    for begin in range(first, end, STRETCH):
        r, g, b = summed(begin, min(begin + STRETCH, end), indices, weights, source)
        red, green, blue = red + np.float64(r), green + np.float64(g), blue + np.float64(b)
    return np.float32(red), np.float32(green), np.float32(blue)


@kernel(f"uint64[::1], uint32[::1], {PLANE}, {PLANE}, {PLANE}, int64, {PLANE}")
def product(
    indptr: Whole, indices: Whole, weights: Picture, source: Picture, base: Picture, combine: Any, out: Picture
) -> None:
    """Σ_k weights[k] source[indices[k]] of every row (row_map), and how it meets `base`; pictures (pixels, 3).

    Rows of at most STRETCH entries are summed in float32 alone, which rounds to the same in two thirds of the time.
    """
    rows = out.shape[0]
    for share in numba.prange(SHARES):
        low, high = share * rows // SHARES, (share + 1) * rows // SHARES
        end = np.int64(indptr[low])
        for row in range(low, high):
            first, end = end, np.int64(indptr[row + 1])
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


@kernel(f"float32, {PLANE}, float32, {PLANE}, boolean, {PLANE}")
def combined(a: Any, first: Picture, b: Any, second: Picture, clamp: Any, out: Picture) -> None:
    """a · first + b · second (combine, blend); pictures (rows, values)."""
    for y in numba.prange(out.shape[0]):
        for i in range(out.shape[1]):
            value = a * first[y, i] + b * second[y, i]
            out[y, i] = within(value, np.float32(0), np.float32(1)) if clamp else value


@kernel(f"{PLANE}, {PLANE}, {PLANE}, {PLANE}, {PLANE}, {PLANE}, {PLANE}, boolean, float32, float32, {PLANE}, {PLANE}")
def step(
    descent: Picture,
    y: Picture,
    p: Picture,
    step_size: Picture,
    damping: Picture,
    right: Picture,
    down: Picture,
    draws: Any,
    momentum: Any,
    over_relaxation: Any,
    next_p: Picture,
    next_y: Picture,
) -> None:
    """One projected gradient step (refinement_step); pictures (rows, values).  draws : the prior is not 0."""
    height, width = y.shape
    for row in numba.prange(height):
        for i in range(width):
            here, slope = y[row, i], descent[row, i]
            if draws:
                pull = damping[row, i] * here
                if i + 3 < width:
                    pull += right[row, i] * (here - y[row, i + 3])
                if i >= 3:
                    pull += right[row, i - 3] * (here - y[row, i - 3])
                if row + 1 < height:
                    pull += down[row, i] * (here - y[row + 1, i])
                if row >= 1:
                    pull += down[row - 1, i] * (here - y[row - 1, i])
                slope -= pull
            size = step_size[row, i]
            q = within(here + size * slope, np.float32(0), np.float32(1)) if size > 0 else np.float32(0)
            next_p[row, i] = q
            next_y[row, i] = q + momentum * (q - p[row, i]) + over_relaxation * (q - here)


@kernel(
    f"{', '.join([PICTURE] * 6)}, int64[::1], int64[::1], float32, float32, "
    "float64[::1], float64[::1], boolean, float64[::1]"
)
def clip_sums(
    u: Picture,
    near: Picture,
    near_white: Picture,
    near_ambient: Picture,
    ambient: Picture,
    most: Picture,
    rows: Whole,
    columns: Whole,
    white: Any,
    budget: Any,
    offsets: NDArray[np.float64],
    shares: NDArray[np.float64],
    bright: Any,
    out: NDArray[np.float64],
) -> None:
    """What clips less what may, of each candidate (clip_sums in adaptation.py).  bright : what is too bright counts."""
    for i in numba.prange(out.size):
        o, share, total = np.float32(offsets[i]), np.float32((1 - offsets[i]) * shares[i]), 0.0
        for y in rows:
            for x in columns:
                if most[y, x, 3] > 0:
                    for c in range(3):
                        needed = white * (share * near[y, x, c] + o * near_white[y, x, c]) - near_ambient[y, x, c]
                        clipped = max(-needed, np.float32(0))
                        if bright:
                            clipped += max(needed - most[y, x, c], np.float32(0))
                        total += clipped - budget * max(white * u[y, x, c], ambient[y, x, c])
        out[i] = total
