"""Camera defocus: each ray of a pixel passes another point of the lens, and all its rays meet in the plane of focus."""

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.simulation.lens import LensPoints
from counterlight.tools.simulation.scene import Scene


def through_the_lens(scene: Scene, directions: FloatArray, pixel: IntArray) -> tuple[FloatArray, FloatArray]:
    """Returns origins and directions (rays, 3) of rays through points of the lens.

    A ray from the lens' point a has the direction d f − a, so that all rays of one d meet at depth f.

    directions : (rays, 3). Directions d through the lens' centre, with depth 1 along the axis.
    """
    camera = scene.camera
    a, b = LensPoints(camera.aperture).of(pixel, 1)
    offset = a * camera.right + b * camera.up
    return camera.position + offset, directions - offset / camera.focus_distance
