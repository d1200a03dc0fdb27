"""Projector defocus: the whole lens lights each point, so a point receives light of a disc of pixels (thin lens).

The lens is focused at depth f. Its point a lights a point X at depth z with the pixel that is sharp where the line a X
cuts the plane of focus. That is the pinhole's pixel, moved by a (1/f − 1/z) on the plane at depth 1. The lens is small
compared with the distance, so each lens point sends an equal share of the pinhole's irradiance. The lens points are a
sequence that fills the lens evenly at any count, and the samples of one camera pixel take different points.
"""

import numpy as np

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.simulation.lens import LensPoints
from counterlight.tools.simulation.paths import Arrivals, Samples
from counterlight.tools.simulation.projector_side import irradiance
from counterlight.tools.simulation.scene import Scene

POINTS_A_PIXEL = 4.0  # lens points, over all samples of a camera pixel, per projector pixel of the disc
MAX_POINTS = 64  # points per sample
ARRIVALS_AT_ONCE = 1 << 20


def arrivals(scene: Scene, samples: Samples) -> list[Arrivals]:
    """Returns arrivals through points of the lens; a larger circle of confusion gets more points."""
    projector = scene.projector
    x, y, depth = projector.project(samples.point)
    light = irradiance(scene, samples.point, samples.normal)
    reach = projector.blur_pixels(np.where(depth > 0, depth, np.nan)) / 2
    near = (x > -reach) & (x < projector.width + reach) & (y > -reach) & (y < projector.height + reach)
    lit = np.flatnonzero(near & (light > 0))
    pixels = np.pi * reach[lit] ** 2 + 2 * reach[lit]  # pixels of the disc and of its edge
    wanted = np.clip(np.ceil(POINTS_A_PIXEL * pixels / scene.samples**2), 1, MAX_POINTS)
    counts = (2 ** np.ceil(np.log2(wanted))).astype(np.int64)
    batches = []
    for count in np.unique(counts).tolist():
        chosen = lit[counts == count]
        size = max(1, ARRIVALS_AT_ONCE // count)
        for start in range(0, chosen.size, size):
            some = chosen[start : start + size]
            batches.append(_through_the_lens(scene, samples.pixel, some, count, (x, y, depth, light)))
    return batches


def _through_the_lens(
    scene: Scene, pixel: IntArray, index: IntArray, count: int, seen: tuple[FloatArray, ...]
) -> Arrivals:
    """Returns arrivals of some samples through `count` lens points each.

    seen : x, y and depth in the projector, and irradiance; each (samples,).
    """
    projector = scene.projector
    x, y, depth, light = (column[index] for column in seen)
    a, b = LensPoints(projector.aperture).of(pixel[index], count)
    bend = (1 / projector.focus_distance - 1 / depth)[:, None] / 2
    moved_x = x[:, None] + a * bend * projector.width / projector.tan_half[0]
    moved_y = y[:, None] - b * bend * projector.height / projector.tan_half[1]
    target = projector.pixel_at(moved_x, moved_y).ravel()
    inside = target >= 0
    origin = projector.position + a[..., None] * projector.right + b[..., None] * projector.up
    share = np.repeat(light / count, count)[inside, None]
    return Arrivals(np.repeat(index, count)[inside], target[inside], share, origin.reshape(-1, 3)[inside], "direct")
