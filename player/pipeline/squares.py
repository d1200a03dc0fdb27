"""A square of a drive solved to the end, its surroundings held: how much better that part of a picture could be.

With r = b − T p, d = TᵀW r and P the prior of refinement.py, a change δ of the drive changes the objective by

    −(d − P p)ᵀδ + ½ δᵀ(TᵀWT + P)δ,        0 ≤ p + δ ≤ 1,

of which a square of the projector's picture needs p, d and its own rows of TᵀW alone: neither b nor any picture of
the camera's. Far light counts in d; what δ itself changes of it is left out. The unweighted error is the same with
w = 1 where a camera pixel is lit, else 0, and P = 0. survey.py makes a picture's figure of both.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from counterlight.maps.products import kept
from counterlight.maps.room_maps import RefinementMaps
from counterlight.maps.row_map import SparseRows, rows_of
from counterlight.pipeline.refinement import LARGEST_MOMENTUM, OVER_RELAXATION

FloatArray = NDArray[np.float64]
Picture = NDArray[np.float32]
FIRST_LOOK, MOST_STEPS = 16, 2048
SETTLED = 0.03  # of what is gained: where twice the steps bring less, a square is at its end
TO_THE_END = -1
FAINTEST = 1e-12  # of the largest curvature: what is below lights nothing


class Square(NamedTuple):
    """What decides over a part of the projector's picture.

    indptr, indices, weights : its rows of TᵀW, as SparseRows'; the indices are among the camera pixels that it lights.
    cameras, trust : which these are, and w of them, (camera pixels,).
    step, damping, left, right, up, down : step sizes, η, and ω to each side, (height, width, 3).
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
        """TᵀW of all the camera's pixels, (pixels, 3) -> (projector pixels, 3)."""
        return SparseRows(self.indptr, self.indices, self.weights, self.cameras.size).apply(light[self.cameras])


def square_of(maps: RefinementMaps, part: tuple[slice, slice]) -> Square:
    """Of what steps seek.  part : rows and columns of the projector's picture."""
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


def unweighted(square: Square, lit: NDArray[np.floating]) -> Square:
    """Of the unweighted error over the lit camera pixels, in steps that never overshoot.

    lit : 1 or 0, (camera pixels,), of the whole picture.
    """
    chosen, none = lit.ravel()[square.cameras] > 0, np.zeros_like(square.step)
    scale = np.divide(1, square.trust, out=np.zeros_like(square.trust), where=chosen)
    weights, trust = square.weights * scale[square.indices, None], np.ones_like(square.trust)
    free = square._replace(damping=none, left=none, right=none, up=none, down=none)
    found = free._replace(weights=weights, trust=trust)
    curvature = np.zeros(square.step.shape)
    _lit(found, np.ones(square.step.shape), np.zeros((square.trust.size, 3)), curvature)
    step = np.divide(1, curvature, out=np.zeros_like(curvature), where=curvature > FAINTEST * curvature.max(initial=0))
    return found._replace(step=step.astype(np.float32))


def seen_change(square: Square, change: FloatArray) -> FloatArray:
    """TᵀWT δ, (height, width, 3)."""
    found = np.zeros_like(change)
    _lit(square, change, np.zeros((square.trust.size, 3)), found)
    return found


@kept(nogil=True, error_model="numpy")
def descend(
    square: Square, drive: FloatArray, slope: FloatArray, ahead: FloatArray, made: int, most: int
) -> tuple[FloatArray, int]:
    """Steps of refinement.py inside a square; drive, slope, ahead : p, d − P p and y − p, (height, width, 3).

    made : steps before these, whose schedule goes on for `most` steps; or TO_THE_END: momentum of Nesterov's, begun
    anew where it leads uphill, until the square has SETTLED, or for `most` steps.
    Returns δ and the steps.
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
    """out = (TᵀWT + P) δ; seen becomes T δ, (camera pixels, 3)."""
    _pulled(square, change, out)
    _lit(square, change, seen, out)


@kept(nogil=True, error_model="numpy")
def _lit(square: Square, change: FloatArray, seen: FloatArray, out: FloatArray) -> None:
    """out += TᵀWT δ."""
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
    """out = P δ, δ being 0 around the square."""
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
    """bent, (TᵀWT + P) at, becomes the next change; returns where momentum leads uphill, above 0, (3,)."""
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
