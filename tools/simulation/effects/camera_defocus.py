"""Camera defocus: each ray of a pixel passes another point of the lens and meets the others in the plane of focus."""

from counterlight.arrays import FloatArray, IntArray
from counterlight.tools.simulation.lens import LensPoints
from counterlight.tools.simulation.scene import Scene


def through_the_lens(scene: Scene, directions: FloatArray, pixel: IntArray) -> tuple[FloatArray, FloatArray]:
    """Origins and directions (rays, 3) of rays whose directions through the lens' centre have depth 1 along the axis.

    From the lens' point a towards d f − a: at depth f all rays of one d meet.
    """
    camera = scene.camera
    a, b = LensPoints(camera.aperture).of(pixel, 1)
    offset = a * camera.right + b * camera.up
    return camera.position + offset, directions - offset / camera.focus_distance
