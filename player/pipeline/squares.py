"""Refines one square of a drive to convergence, with fixed surroundings, to find the possible gain of the square.

With r = b − T p, d = TᵀW r and P the prior of refinement.py, a change δ of the drive changes the objective by

    −(d − P p)ᵀδ + ½ δᵀ(TᵀWT + P)δ,        0 ≤ p + δ ≤ 1.

A square of the projector picture needs only p, d and its own rows of TᵀW for this; it needs neither b nor any camera
picture. Far light is included in d, but the change of far light by δ is ignored. The unweighted error has the same form
with P = 0, and w = 1 for lit camera pixels, else 0. survey.py combines both.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import BoolArray
from counterlight.maps.products import kept
from counterlight.maps.room_maps import RefinementMaps
from counterlight.maps.row_map import SparseRows, rows_of
from counterlight.pipeline.refinement import LARGEST_MOMENTUM, OVER_RELAXATION

FloatArray = NDArray[np.float64]
Picture = NDArray[np.float32]
FIRST_LOOK, MOST_STEPS = 16, 2048
SETTLED = 0.03  # if twice the steps gain less than this share of the total, a square counts as solved
TO_THE_END = -1
FAINTEST = 1e-12  # share of the channel's largest curvature; smaller values count as unlit


class Square(NamedTuple):
    """The part of the problem that belongs to a square of the projector picture.

    indptr, indices, weights : the square's rows of TᵀW, as in SparseRows; indices count the camera pixels that it
        lights.
    cameras, trust : (camera pixels,). Index in the camera picture, and w, of these camera pixels.
    step, damping : (height, width, 3). Step sizes and η.
    left, right, up, down : (height, width, 3). ω of the tie on each side.
    """

    indptr: NDArray[np.uint64]
    indices: NDArray[np.uint32]
    weights: Picture
    cameras: NDArray[np.int32]
    trust: Picture
    step: Picture
    damping: Picture
    left: Picture
    right: Picture
    up: Picture
    down: Picture

    def gathered(self, light: NDArray[np.floating]) -> FloatArray:
        """Return TᵀW of a whole camera picture, (pixels, 3) -> (projector pixels, 3)."""
        return SparseRows(self.indptr, self.indices, self.weights, self.cameras.size).apply(light[self.cameras])


def square_of(maps: RefinementMaps, part: tuple[slice, slice]) -> Square:
    """Return the square for the objective of the steps. part : rows and columns of the projector picture."""
    rows, prior = rows_of(maps.dual, part), maps.prior
    cameras, local = np.unique(rows.indices, return_inverse=True)
    left = np.pad(prior.right, ((0, 0), (1, 0), (0, 0)))[part]
    up = np.pad(prior.down, ((1, 0), (0, 0), (0, 0)))[part]
    pictures = maps.step_size[part], prior.damping[part], left, prior.right[part], up, prior.down[part]
    return Square(
        rows.indptr.astype(np.uint64),
        local.astype(np.uint32),
        rows.weights,
        cameras.astype(np.int32),
        np.ascontiguousarray(maps.weights.ravel()[cameras], np.float32),
        *(np.ascontiguousarray(picture, np.float32) for picture in pictures),
    )


def unweighted(square: Square, lit: BoolArray) -> Square:
    """Return the square for the unweighted error over the lit camera pixels, with step sizes that never overshoot.

    lit : (camera height, camera width).
    """
    chosen, none = lit.ravel()[square.cameras], np.zeros_like(square.step)
    scale = np.divide(1, square.trust, out=np.zeros_like(square.trust), where=chosen)
    weights, trust = square.weights * scale[square.indices, None], np.ones_like(square.trust)
    free = square._replace(damping=none, left=none, right=none, up=none, down=none)
    found = free._replace(weights=weights, trust=trust)
    curvature = np.zeros(square.step.shape)
    _lit(found, np.ones(square.step.shape), np.zeros((square.trust.size, 3)), curvature)
    bright = curvature > FAINTEST * curvature.max(axis=(0, 1), initial=0)
    step = np.divide(1, curvature, out=np.zeros_like(curvature), where=bright)
    return found._replace(step=step.astype(np.float32))


def seen_change(square: Square, change: FloatArray) -> FloatArray:
    """Return TᵀWT δ, (height, width, 3)."""
    found = np.zeros_like(change)
    _lit(square, change, np.zeros((square.trust.size, 3)), found)
    return found


@kept(nogil=True, error_model="numpy")
def descend(
    square: Square, drive: FloatArray, slope: FloatArray, ahead: FloatArray, made: int, most: int
) -> tuple[FloatArray, int]:
    """Make steps of refinement.py inside a square.

    drive, slope, ahead : (height, width, 3). p, d − P p and y − p.
    made : number of earlier steps; the momentum schedule continues for `most` steps. TO_THE_END uses Nesterov's
        momentum, restarted where it leads uphill, until the square has SETTLED.
    most : largest number of steps.

    Returns δ and the number of steps.
    """
    change, at, bent = np.zeros_like(drive), ahead.copy(), np.zeros_like(drive)
    seen, pace, momentum = np.zeros((square.trust.size, 3)), np.ones(3), np.zeros(3)
    before, look, steps = 0.0, FIRST_LOOK, 0
    while steps < most:
        steps += 1
        _curved(square, at, seen, bent)
        uphill = _stepped(square, drive, slope, change, at, bent)
        for i in range(3):
            if made == TO_THE_END:
                pace[i] = 1.0 if uphill[i] > 0 else pace[i]
                longer = (1 + np.sqrt(1 + 4 * pace[i] ** 2)) / 2
                momentum[i], pace[i] = (pace[i] - 1) / longer, longer
            else:
                momentum[i] = min((made + steps) / (made + steps + 1), LARGEST_MOMENTUM)
        _extrapolated(change, at, bent, momentum)
        if steps == look and made == TO_THE_END:
            look *= 2
            _curved(square, change, seen, bent)
            gained = np.sum(slope * change) - np.sum(change * bent) / 2
            if gained - before <= SETTLED * gained:
                break
            before = gained
    return change, steps


@kept(nogil=True, error_model="numpy")
def _curved(square: Square, change: FloatArray, seen: FloatArray, out: FloatArray) -> None:
    """Compute out = (TᵀWT + P) δ; `seen` becomes T δ, (camera pixels, 3)."""
    _pulled(square, change, out)
    _lit(square, change, seen, out)


@kept(nogil=True, error_model="numpy")
def _lit(square: Square, change: FloatArray, seen: FloatArray, out: FloatArray) -> None:
    """Compute out += TᵀWT δ."""
    height, width, _ = change.shape
    seen[:] = 0
    for row in range(height * width):
        red, green, blue = change[row // width, row % width]
        for k in range(square.indptr[row], square.indptr[row + 1]):
            at = square.indices[k]
            seen[at, 0] += square.weights[k, 0] * red
            seen[at, 1] += square.weights[k, 1] * green
            seen[at, 2] += square.weights[k, 2] * blue
    for at in range(seen.shape[0]):
        for i in range(3):
            seen[at, i] /= square.trust[at]
    for row in range(height * width):
        red, green, blue = out[row // width, row % width]
        for k in range(square.indptr[row], square.indptr[row + 1]):
            at = square.indices[k]
            red += square.weights[k, 0] * seen[at, 0]
            green += square.weights[k, 1] * seen[at, 1]
            blue += square.weights[k, 2] * seen[at, 2]
        out[row // width, row % width, 0] = red
        out[row // width, row % width, 1] = green
        out[row // width, row % width, 2] = blue


@kept(nogil=True, error_model="numpy")
def _pulled(square: Square, change: FloatArray, out: FloatArray) -> None:
    """Compute out = P δ, with δ = 0 around the square."""
    height, width, _ = change.shape
    for y in range(height):
        for x in range(width):
            for i in range(3):
                left, right = square.left[y, x, i], square.right[y, x, i]
                up, down = square.up[y, x, i], square.down[y, x, i]
                pulled = (square.damping[y, x, i] + left + right + up + down) * change[y, x, i]
                pulled -= left * change[y, x - 1, i] if x > 0 else 0.0
                pulled -= right * change[y, x + 1, i] if x + 1 < width else 0.0
                pulled -= up * change[y - 1, x, i] if y > 0 else 0.0
                pulled -= down * change[y + 1, x, i] if y + 1 < height else 0.0
                out[y, x, i] = pulled


@kept(nogil=True, error_model="numpy")
def _stepped(
    square: Square, drive: FloatArray, slope: FloatArray, change: FloatArray, at: FloatArray, bent: FloatArray
) -> FloatArray:
    """Replace `bent`, which is (TᵀWT + P) times `at`, by the next change.

    Returns (3,), a value per channel. A positive value means that momentum leads uphill.
    """
    height, width, _ = drive.shape
    uphill = np.zeros(3)
    for y in range(height):
        for x in range(width):
            for i in range(3):
                p, size, following = drive[y, x, i], square.step[y, x, i], 0.0
                if size > 0:
                    wanted = p + at[y, x, i] + size * (slope[y, x, i] - bent[y, x, i])
                    following = min(max(wanted, 0.0), 1.0) - p
                uphill[i] += (at[y, x, i] - following) * (following - change[y, x, i])
                bent[y, x, i] = following
    return uphill


@kept(nogil=True, error_model="numpy")
def _extrapolated(change: FloatArray, at: FloatArray, following: FloatArray, momentum: FloatArray) -> None:
    height, width, _ = change.shape
    for y in range(height):
        for x in range(width):
            for i in range(3):
                q = following[y, x, i]
                at[y, x, i] = q + momentum[i] * (q - change[y, x, i]) + OVER_RELAXATION * (q - at[y, x, i])
                change[y, x, i] = q
