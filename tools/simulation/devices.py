"""Projector and camera: position, direction, field of view and lens."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from counterlight.arrays import FloatArray, IntArray
from counterlight.errors import InputError
from counterlight.files.tables import Table, Vector
from counterlight.maps.mixing import invertible
from counterlight.processing import LEVELS, Processing
from counterlight.response import Response, read_response

MAX_SIDE = 4096
MOST_SHIFT = 100.0  # projector pixels, of a primary's picture
MOSAICS = ("RGGB", "BGGR", "GRBG", "GBRG")


@dataclass(frozen=True)
class Device:
    """A picture plane behind a thin lens. Right, up and forward are orthonormal.

    Pixel (x, y), continuous, row 0 at the top, looks through the lens' centre along
    forward + (2x/width − 1) tan_x right − (2y/height − 1) tan_y up, unless the lens bends it (effects/distortion.py).

    tan_half : (x, y).
    target_distance : metres to look_at.
    aperture : the lens' diameter in metres; 0 for a pinhole.
    focus_distance : depth along the axis that is sharp, metres.
    vignetting : "cos4", or the share of light lost in the corner; the loss grows with the squared radius.
    distortion : k1, k2, p1, p2, k3 of OpenCV's model; all 0 for none.
    """

    width: int
    height: int
    position: Vector
    right: Vector
    up: Vector
    forward: Vector
    tan_half: tuple[float, float]
    target_distance: float
    aperture: float
    focus_distance: float
    vignetting: str | float
    distortion: tuple[float, ...]

    @property
    def pixels(self) -> int:
        return self.width * self.height

    @property
    def pixel_area(self) -> float:
        """Area of one pixel on the plane at depth 1."""
        return 4 * self.tan_half[0] * self.tan_half[1] / self.pixels

    def resized(self, height: int, width: int) -> Self:
        """Returns the device with another picture size and the same horizontal field of view."""
        if max(height, width) > MAX_SIDE:
            raise InputError(f"size {width}x{height}: expected at most {MAX_SIDE} pixels a side")
        tan_x = self.tan_half[0]
        return replace(self, width=width, height=height, tan_half=(tan_x, tan_x * height / width))

    def moved(self, right: float, up: float) -> Self:
        """Returns the device moved by that many metres, turned towards the same point, with the same relative focus."""
        target = self.position + self.target_distance * self.forward
        position = self.position + right * self.right + up * self.up
        towards = target - position
        distance = float(np.linalg.norm(towards))
        forward = towards / distance
        across = np.cross(forward, self.up)
        across = across / np.linalg.norm(across)
        return replace(
            self,
            position=position,
            right=across,
            up=np.cross(across, forward),
            forward=forward,
            target_distance=distance,
            focus_distance=self.focus_distance * distance / self.target_distance,
        )

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Pixel coordinates x, y (continuous) and depth along the axis of points (n, 3); NaN behind the device."""
        towards = points - self.position
        depth = towards @ self.forward
        safe = np.where(depth > 0, depth, np.nan)
        return *self.picture_of(towards @ self.right / safe, towards @ self.up / safe), depth

    def picture_of(self, across: FloatArray, up: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns pixel coordinates of the directions forward + across · right + up · up; NaN outside the picture."""
        return (across / self.tan_half[0] + 1) * self.width / 2, (1 - up / self.tan_half[1]) * self.height / 2

    def direction_of(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns across and up of pixel coordinates; the inverse of picture_of."""
        return (2 * x / self.width - 1) * self.tan_half[0], (1 - 2 * y / self.height) * self.tan_half[1]

    def crowding(self, across: FloatArray, up: FloatArray) -> FloatArray | float:
        """Returns the pixel density on the plane at depth 1, relative to the picture's centre."""
        return 1.0

    def pixel_at(self, x: FloatArray, y: FloatArray) -> IntArray:
        """Returns the index of the pixel that contains (x, y); −1 outside the picture or behind the device."""
        inside = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)  # False for NaN
        column = np.where(inside, x, 0).astype(np.int64)
        row = np.where(inside, y, 0).astype(np.int64)
        return np.where(inside, row * self.width + column, -1)

    def pixel_rays(self, rows: range, samples: int) -> tuple[FloatArray, IntArray]:
        """Returns directions (rays, 3) of samples × samples rays per pixel of some rows, and each ray's pixel index.

        The rays pass through the lens' centre, and their depth along the axis is 1.
        """
        offset = (np.arange(samples) + 0.5) / samples
        y, x, sy, sx = np.meshgrid(np.array(rows), np.arange(self.width), offset, offset, indexing="ij")
        return self.rays((x + sx).ravel(), (y + sy).ravel()), (y * self.width + x).ravel()

    def rays(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Returns directions (n, 3) of depth 1 through the lens' centre at pixel coordinates."""
        across, up = self.direction_of(x, y)
        return np.asarray(self.forward + across[:, None] * self.right + up[:, None] * self.up)

    def blur_pixels(self, depth: FloatArray) -> FloatArray:
        """Returns the diameter in pixels of the circle of confusion at depths z.

        The diameter is aperture · |1/f − 1/z| · width / (2 tan_x).

        Thin lens: the rays from a point at depth z through a lens of diameter a cut the plane of focus, at depth f, in
        a disc of diameter a |1 − f/z|.
        """
        return np.asarray(
            self.aperture * np.abs(1 / self.focus_distance - 1 / depth) * self.width / (2 * self.tan_half[0])
        )


@dataclass(frozen=True)
class Flicker:
    """Periodic change of the light: amplitude as a share of the mean, and frequency in hertz."""

    depth: float
    hz: float


@dataclass(frozen=True)
class Projector(Device):
    """A projector.

    brightness : radiance of a white card that faces it at target_distance.
    black_level : share of white.
    flicker : flicker of the light; None for steady light.
    lateral : shift right and down, in widths of the picture, and scale of each primary's picture; () if all coincide.
    halo_share : share of light that the lens scatters into a halo.
    halo_radius : angle of the halo, radians.
    """

    brightness: float
    black_level: float
    response: Response
    flicker: Flicker | None = None
    lateral: tuple[tuple[float, float, float], ...] = ()
    halo_share: float = 0.0
    halo_radius: float = 0.0


@dataclass(frozen=True)
class Sensor:
    """Conversion of radiance into code values (EMVA Standard 1288).

    full_well : electrons at saturation; 0 for no photon noise.
    read_noise : electrons.
    exposure_s : seconds of an exposure of 1.
    readout_s : seconds from the first row's exposure to the last row's.
    """

    full_well: float = 20000.0
    read_noise: float = 5.0
    bits: int = 14
    exposure_s: float = 1 / 60
    readout_s: float = 0.0


@dataclass(frozen=True)
class Camera(Device):
    """A camera.

    bloom_share : share of light that lens and sensor scatter into a halo.
    bloom_radius : angle of the halo, radians.
    mixing : (3, 3), channel by primary. What each channel sees of each primary on neutral paint; None: only its own.
    mosaic : colour filters of two rows of two pixels, one of MOSAICS; None: every pixel sees all colours.
    wander : standard deviation of the gain of a capture's channel.
    """

    response: Response
    bloom_share: float
    bloom_radius: float
    sensor: Sensor | None
    mixing: FloatArray | None = None
    mosaic: str | None = None
    wander: float = 0.0


def read_projector(table: Table, folder: Path) -> Projector:
    """Read the projector table of a scene file; `folder` resolves relative paths."""
    flicker, halo = table.table("flicker", optional=True), table.table("halo", optional=True)
    halo_share, halo_radius = _scattering(halo)
    pose = _pose(table)
    projector = Projector(
        **pose,
        brightness=table.number("brightness", 1.0, 1e-6, 1e6),
        black_level=table.number("black_level", 0.0, 0.0, 1.0),
        response=_with_vividness(table, read_response(table, folder)),
        lateral=_lateral(table, pose["width"]),
        halo_share=halo_share,
        halo_radius=halo_radius,
        flicker=Flicker(flicker.number("depth", None, 0, 1), flicker.number("hz", None, 1, 1e5))
        if flicker.values
        else None,
    )
    for part in (table, flicker, halo):
        part.refuse_unknown()
    return projector


def read_camera(table: Table, folder: Path) -> Camera:
    bloom, sensor = table.table("bloom", optional=True), table.table("sensor", optional=True)
    bloom_share, bloom_radius = _scattering(bloom)
    camera = Camera(
        **_pose(table),
        response=read_response(table, folder),
        bloom_share=bloom_share,
        bloom_radius=bloom_radius,
        sensor=_sensor(sensor) if sensor.values else None,
        mixing=_mixing(table),
        mosaic=table.choice("mosaic", MOSAICS) if "mosaic" in table else None,
        wander=table.number("wander", 0.0, 0.0, 0.2),
    )
    if camera.response.segment is not None or camera.response.processing is not None:
        raise table.refusal(": white_segment and processing are of a projector; leave them out")
    for part in (table, bloom, sensor):
        part.refuse_unknown()
    return camera


def _scattering(halo: Table) -> tuple[float, float]:
    """Returns the share of light in a halo and its radius in radians; 0 for an empty table."""
    if not halo.values:
        return 0.0, 0.0
    return halo.number("share", 0.0, 0.0, 0.9), float(np.radians(halo.number("radius_deg", None, 0.001, 30.0)))


def _lateral(table: Table, width: int) -> tuple[tuple[float, float, float], ...]:
    lateral = table.table("lateral_colour", optional=True)
    if not lateral.values:
        return ()
    shifts = lateral.rows("shift", 3, 2, -MOST_SHIFT, MOST_SHIFT) if "shift" in lateral else np.zeros((3, 2))
    scales = lateral.numbers("scale", 3, (1.0,) * 3, 0.9, 1.1)
    lateral.refuse_unknown()
    return tuple((float(x) / width, float(y) / width, float(z)) for (x, y), z in zip(shifts, scales, strict=True))


def _with_vividness(table: Table, response: Response) -> Response:
    """Returns the response with colour processing: 1 + v (1 − m) of a primary's light, with m the other codes' mean."""
    if "vividness" not in table:
        return response
    vividness = table.numbers("vividness", 3, None, -0.5, 2.0)
    if response.segment is not None or response.processing is not None:
        raise table.refusal(": expected one of vividness, processing and white_segment; leave the others out")
    steps = np.linspace(0, 1, LEVELS)
    codes = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    factors = 1 + vividness * (1 - (codes.sum(axis=1, keepdims=True) - codes) / 2)
    return replace(response, processing=Processing(tuple(map(tuple, factors.tolist()))))


def _mixing(table: Table) -> FloatArray | None:
    if "mixing" not in table:
        return None
    mixing = table.rows("mixing", 3, 3, 0.0, 1.0)
    if not invertible(mixing):
        raise table.wrong(
            "mixing", "three rows, one for each channel, of its share of red, green and blue; no two alike"
        )
    return mixing


def _sensor(table: Table) -> Sensor:
    return Sensor(
        full_well=table.number("full_well_electrons", 20000.0, 1.0, 1e9),
        read_noise=table.number("read_noise_electrons", 5.0, 0.0, 1e6),
        bits=table.integer("bits", 12, 1, 16),
        exposure_s=table.number("exposure_s", 1 / 60, 1e-6, 3600.0),
        readout_s=table.number("readout_s", 0.0, 0.0, 3600.0),
    )


def _pose(table: Table) -> dict[str, Any]:
    """Returns the fields that both devices share."""
    width, height = (table.integer(key, None, 1, MAX_SIDE) for key in ("width", "height"))
    position, look_at = table.vector("position"), table.vector("look_at")
    angle = table.number("horizontal_field_of_view_deg", None, 0.1, 170.0)
    forward = look_at - position
    distance = float(np.linalg.norm(forward))
    if distance == 0:
        raise InputError(f"{table.where}: position and look_at are the same point; move one")
    forward = forward / distance
    up = table.vector("up", (0.0, 1.0, 0.0))
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9:
        raise InputError(f"{table.where}: looks straight along up = {up.tolist()}; give another up")
    right = right / np.linalg.norm(right)
    tan_x = float(np.tan(np.radians(angle) / 2))
    return {
        "width": width,
        "height": height,
        "position": position,
        "right": right,
        "up": np.cross(right, forward),
        "forward": forward,
        "tan_half": (tan_x, tan_x * height / width),
        "target_distance": distance,
        "aperture": table.number("aperture", 0.0, 0.0, 1.0),
        "focus_distance": table.number("focus_distance", distance, 1e-3, 1e6),
        "vignetting": _vignetting(table),
        "distortion": tuple(table.numbers("distortion", 5, (0.0,) * 5, -10.0, 10.0).tolist()),
    }


def _vignetting(table: Table) -> str | float:
    if table.values.get("vignetting") == "cos4":
        return table.text("vignetting")
    try:
        return table.number("vignetting", 0.0, 0.0, 0.99)
    except InputError as error:
        raise InputError(f'{error}, or "cos4"') from None
