"""Lens distortion: the lens bends straight lines of the room (Brown 1966; OpenCV's five coefficients).

The lens shows the direction (x, y) at depth 1, y down, r² = x² + y², where a lens without distortion would show

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y

Beyond some r the polynomial turns back, and the lens shows nothing there. A projector's panel is lit evenly, so each
pixel carries the same flux. The light at a place is proportional to the pixel density there: the Jacobian's
determinant. Circles of confusion keep their size in pixels, and halos keep their shape.
"""

from dataclasses import fields, replace
from typing import Any

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.tools.simulation.devices import Camera, Device, Projector
from counterlight.tools.simulation.scene import Scene

RADII = 2048  # entries in the table of the radial polynomial, where Newton's method starts
STEPS = 20  # largest number of steps of Newton's method
EXACT = 1e-9  # tolerance of a direction, at depth 1
FARTHEST = 100.0  # largest distance of a direction from the axis, at depth 1


class _Distorted(Device):
    """A device whose lens bends its picture."""

    def picture_of(self, across: FloatArray, up: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y, determinant, _ = _bent(self.distortion, across, -up)
        shown = (np.hypot(across, up) < turning(self.distortion)) & (determinant > 0)  # False for NaN
        return super().picture_of(np.where(shown, x, np.nan), -y)

    def direction_of(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        across, up = super().direction_of(x, y)
        straight_x, straight_y = _straightened(self.distortion, across, -up)
        return straight_x, -straight_y

    def crowding(self, across: FloatArray, up: FloatArray) -> FloatArray | float:
        return np.maximum(_bent(self.distortion, across, -up)[2], 0)


class _DistortedCamera(_Distorted, Camera):
    pass


class _DistortedProjector(_Distorted, Projector):
    pass


def distorted(scene: Scene) -> Scene:
    """Returns the scene with lenses that bend. Raises InputError for a lens that does not fill its own picture."""
    camera, projector = scene.camera, scene.projector
    if any(camera.distortion):
        camera = _DistortedCamera(**_described(camera))
    if any(projector.distortion):
        projector = _DistortedProjector(**_described(projector))
    for name, device in (("camera", camera), ("projector", projector)):
        _check(device, f"{scene.name}: [{name}], distortion")
    return replace(scene, camera=camera, projector=projector)


def _described(device: Device) -> dict[str, Any]:
    return {field.name: getattr(device, field.name) for field in fields(device)}


def _check(device: Device, where: str) -> None:
    """Raises InputError unless the lens shows the whole picture up to its border."""
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(0, device.width, 33), np.linspace(0, device.height, 33)))
    back = np.stack(device.picture_of(*device.direction_of(x, y)))
    if not np.allclose(back, (x, y), rtol=0, atol=1e-3):  # False for NaN
        raise InputError(
            f"{where}: found {list(device.distortion)}, which turns back before the picture's corner; "
            "smaller numbers, in the order k1, k2, p1, p2, k3, reach it"
        )


def turning(coefficients: tuple[float, ...]) -> float:
    """Returns the r at which the radial polynomial turns back; infinite if it never does."""
    k1, k2, _, _, k3 = coefficients
    roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
    squares = roots.real[(np.abs(roots.imag) < EXACT) & (roots.real > 0)]
    return float(np.sqrt(squares.min())) if squares.size else np.inf


@np.errstate(all="ignore")  # _check reports directions without a solution
def _straightened(coefficients: tuple[float, ...], x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns x, y of x', y': the radial polynomial read backwards, then Newton's method."""
    k1, k2, _, _, k3 = coefficients
    bent_radius, farthest = np.hypot(x, y), min(turning(coefficients), FARTHEST)
    radius = np.tan(np.linspace(0, np.arctan(farthest), RADII))
    scale = np.interp(bent_radius, _bent((k1, k2, 0.0, 0.0, k3), radius, 0 * radius)[0], radius)
    share = np.divide(scale, bent_radius, out=np.ones_like(scale), where=bent_radius > 0)
    straight_x, straight_y = x * share, y * share
    for _ in range(STEPS):
        bent_x, bent_y, determinant, (xx, xy, yy) = _bent(coefficients, straight_x, straight_y)
        off_x, off_y = (x - bent_x) / determinant, (y - bent_y) / determinant
        straight_x, straight_y = straight_x + yy * off_x - xy * off_y, straight_y + xx * off_y - xy * off_x
        if max(np.abs(x - bent_x).max(initial=0), np.abs(y - bent_y).max(initial=0)) < EXACT:
            break
    return straight_x, straight_y


@np.errstate(all="ignore")  # overflows far outside the picture
def _bent(
    coefficients: tuple[float, ...], x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[FloatArray, ...]]:
    """Returns x', y', the Jacobian's determinant, and its parts dx'/dx, dx'/dy = dy'/dx, dy'/dy."""
    k1, k2, p1, p2, k3 = coefficients
    square = x**2 + y**2
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    slope = 2 * (k1 + square * (2 * k2 + square * 3 * k3))  # d radial / d(r²/2)
    xx = radial + slope * x**2 + 2 * p1 * y + 6 * p2 * x
    xy = slope * x * y + 2 * p1 * x + 2 * p2 * y
    yy = radial + slope * y**2 + 6 * p1 * y + 2 * p2 * x
    return (
        x * radial + 2 * p1 * x * y + p2 * (square + 2 * x**2),
        y * radial + p1 * (square + 2 * y**2) + 2 * p2 * x * y,
        xx * yy - xy**2,
        (xx, xy, yy),
    )
