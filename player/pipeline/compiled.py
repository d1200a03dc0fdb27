"""The passes of a frame, compiled for the CPU by Numba. cpu_renderer.py runs them; reference.py defines their results.

Pictures are (rows, columns, channels) float32, contiguous. Each kernel fills `out` and allocates at most a few rows.
Cores share the rows, and one core computes each value in a fixed order. The output is therefore the same bytes on every
run, for any number of threads. Arithmetic is float32, as in the shaders; long sums are accumulated in float64. Kernels
hold Python's lock, so that the show and the estimating thread never start parallel loops at the same time. With Numba's
own thread pool ("workqueue"), that would end the process.
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
from counterlight.maps.products import kept, unpack_entries
from counterlight.pipeline.reference import TINY

Picture = NDArray[np.float32]
Whole = NDArray[np.integer]
REPLACE, ADD, SUBTRACT, CLAMP = range(4)  # how a product is combined with its base
STRETCH = 64  # entries of a row that are summed in float32; a sum entirely in float64 takes twice as long
SHARES = 64  # parts of the rows of a product; each core takes one part at a time
PICTURE, PLANE, LINE = "float32[:, :, ::1]", "float32[:, ::1]", "float32[::1]"

_UNPACKING = f"uint32[:, ::1], {PICTURE}, uint32[:, ::1], int64[::1], int32[::1], {PLANE}"
KERNELS: list[tuple[Any, tuple[str, ...]]] = [(unpack_entries, (_UNPACKING,))]


def kernel(*signatures: str) -> Callable[[Callable[..., None]], Any]:
    """Decorator: compile on first use or by `prepare`, and cache for the next start if a writable folder exists."""
    options: dict[str, Any] = {"parallel": True, "error_model": "numpy"}

    def compiled(function: Callable[..., None]) -> Any:
        made = kept(**options)(function)
        KERNELS.append((made, signatures))
        return made

    return compiled


def prepare(compiling: Callable[[int], None] = lambda left: None) -> None:
    """Load every cached kernel, and compile the others.

    compiling : called before each compilation with the number of remaining kernels. Numba's own event triggers the
        call. Load time would be no criterion: loading all kernels takes a second, and longer on a busy machine.
    """
    wanted = [(made, signature) for made, signatures in KERNELS for signature in signatures]
    for number, (made, signature) in enumerate(wanted):
        # A signature passed as text would be cached separately from the one that a call compiles.
        types, _ = normalize_signature(f"({signature})")  # type: ignore[no-untyped-call]
        compiles = _Compiles(partial(compiling, len(wanted) - number))
        # OSError: compiled, but the disk is full
        with suppress(OSError), event.install_listener("numba:compile", compiles):
            made.compile(types)


def is_kept() -> bool:
    """Returns whether a folder exists that caches kernels for the next start."""
    return all(made.stats.cache_path is not None for made, _ in KERNELS)


class _Compiles(event.Listener):
    """Calls `started` when Numba compiles a function, but not when Numba loads one from the cache."""

    def __init__(self, started: Callable[[], None]) -> None:
        self._started = started

    def on_start(self, event: Any) -> None:
        self._started()

    def on_end(self, event: Any) -> None:
        """Required by the interface; does nothing."""


def inlined(function: Callable[..., Any]) -> Any:
    """Decorator: inline the function into the kernels that call it."""
    return numba.njit(inline="always", error_model="numpy")(function)


@inlined
def within(value: Any, low: Any, high: Any) -> Any:
    return min(max(value, low), high)


@inlined
def _between(first: Any, second: Any, share: Any) -> Any:
    return np.float32(first) + (np.float32(second) - np.float32(first)) * share


@inlined
def looked_up(table: Any, share: Any) -> Any:
    """Look up a share 0..1 in a (samples,) table, interpolated linearly. Unsigned indices need no wraparound check."""
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
    """Convert codes to linear light (planes_to_linear): table lookup of clamp(matrix · (Y, Cb, Cr) + lift).

    rows, columns : (2, length). The chroma samples on either side of a pixel.
    down, across : (length,). Weight of the second chroma sample.
    start : index of the first stored pixel in the upright picture.
    right, below : index steps in the upright picture to the next stored pixel to the right, and below.
    out : (pixels, 3). The upright picture.

    Separate loops over a row let the compiler process several pixels at a time.
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
    """Filter along x (resample): pixel x of a row sums weights[x] times the source pixels from first[x] on."""
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
    """Filter along y (resample). source, out : (rows, values)."""
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
    """Place a picture by a projective map, with black around it (pinned). `across`, `down` : empty without a screen."""
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
    """Return the position to which H maps a pixel centre, and the third homogeneous component."""
    w = H[2, 0] * (x + 0.5) + H[2, 1] * (y + 0.5) + H[2, 2]
    u = H[0, 0] * (x + 0.5) + H[0, 1] * (y + 0.5) + H[0, 2]
    v = H[1, 0] * (x + 0.5) + H[1, 1] * (y + 0.5) + H[1, 2]
    return u / w, v / w, w


@inlined
def _taps(centre: Any, reach: Any, count: Any, most: Any) -> Any:
    """Return the first and last sample of a tent filter, the step between samples, and its radius."""
    radius = max(reach, 1.0)
    first, last = np.ceil(centre - radius - 0.5), np.floor(centre + radius - 0.5)
    step = max(np.ceil(2 * radius / most), 1.0)
    return np.int64(max(first, 0.0)), np.int64(min(last, count - 1.0)), np.int64(step), radius


@inlined
def _turned(row: Any, squares: Any) -> Any:
    """Returns Q Qᵀ times a row of A (maps/mixing.py)."""
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
    """Returns how far a limit moves its primary beyond the move so far, divided by N's diagonal (maps/mixing.py)."""
    alone = light - own * moved
    return (within(alone, np.float32(0), most) - alone) / own - moved


@inlined
def _nearest(red: Any, green: Any, blue: Any, most: Any, rows: Any, squares: Any) -> Any:
    """Return the light within the limits that the camera sees nearest to the target; see maps/mixing.py."""
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
    """Compute b = gain · picture + offset − ambient (desired_light), apply a matrix per pixel, and limit the result.

    row_red, row_green, row_blue, full, squares : empty arrays switch the matrix or the limits off.
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
    """Return Σ weights[k] source[indices[k]] of the entries from `first` to `end`, in float32."""
    red, green, blue = np.float32(0), np.float32(0), np.float32(0)
    for k in range(first, end):
        at = indices[k]
        red += weights[k, 0] * source[at, 0]
        green += weights[k, 1] * source[at, 1]
        blue += weights[k, 2] * source[at, 2]
    return red, green, blue


@inlined
def summed_long(first: Any, end: Any, indices: Whole, weights: Picture, source: Picture) -> Any:
    """Return the sum of `summed` for a long row: stretches of STRETCH entries, added in float64."""
    red, green, blue = 0.0, 0.0, 0.0
    for begin in range(first, end, STRETCH):
        r, g, b = summed(begin, min(begin + STRETCH, end), indices, weights, source)
        red, green, blue = red + np.float64(r), green + np.float64(g), blue + np.float64(b)
    return np.float32(red), np.float32(green), np.float32(blue)


@kernel(f"uint64[::1], uint32[::1], {PLANE}, {PLANE}, {PLANE}, int64, {PLANE}")
def product(
    indptr: Whole, indices: Whole, weights: Picture, source: Picture, base: Picture, combine: Any, out: Picture
) -> None:
    """Compute Σ_k weights[k] source[indices[k]] of every row (row_map), and combine it with `base`.

    source, base, out : (pixels, 3).

    Rows of at most STRETCH entries are summed in float32 alone: the same rounding in two thirds of the time.
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
    """Compute a · first + b · second (combine, blend); pictures (rows, values)."""
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
    """One projected gradient step (refinement_step); pictures (rows, values). `draws` : the prior is not 0."""
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
    """Compute the clipped light above the budget for each candidate (clip_sums in adaptation.py).

    bright : whether light above the maximum counts, too.
    """
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
