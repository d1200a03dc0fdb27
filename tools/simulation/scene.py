"""Scene files: a projector, a camera and matt surfaces, in TOML that a person reads and writes.

    name = "wall"
    samples = 4                        # rays a camera pixel and axis (default 4)
    cells = 600                        # cells of the far light, all surfaces together (default 600)

    [projector]
    width = 256
    height = 192
    position = [0.6, 0.2, 2.2]         # metres, right-handed, y up
    look_at = [0, 0, 0]
    horizontal_field_of_view_deg = 40
    brightness = 1.0                   # radiance of a white card facing it at look_at's distance (default 1)
    black_level = 0.002                # light of a black pixel, as a share of a white one (default 0)
    response = "srgb"                  # "linear", "srgb" or a gamma (default "linear")

    [camera]                           # width, height, position, look_at, horizontal_field_of_view_deg

    [ambient]
    irradiance = [0.02, 0.02, 0.02]    # on every surface from every side (default none)

    [[surfaces]]
    name = "bricks"
    corner = [-1, -1, 0]               # a parallelogram: corner + u·edge_u + v·edge_v, u, v in 0..1
    edge_u = [2, 0, 0]
    edge_v = [0, 2, 0]
    albedo = [0.8, 0.8, 0.8]           # or: texture = "picture.png" (sRGB, seen from the camera's side: v points up)
                                       # or: pattern = { kind = "bricks", colours = [[..], [..]], repeat = [8, 16] }

Anything else in the file is an error that names the nearest known key.
"""

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from player.errors import InputError
from player.response import Response, parse_response
from tools.simulation.materials import Material, Pattern, PlainColour, Texture, read_texture

Vector = NDArray[np.float64]
PATTERNS = ("bricks", "stripes", "checker")
MAX_SIDE, MAX_SAMPLES, MAX_CELLS = 4096, 16, 4000


@dataclass(frozen=True)
class Pinhole:
    """A projector or camera without a lens. Right, up and forward are orthonormal; tan_half is (x, y).

    Pixel (x, y), continuous, row 0 at the top, looks along
    forward + (2x/width − 1) tan_x right − (2y/height − 1) tan_y up.
    """

    width: int
    height: int
    position: Vector
    right: Vector
    up: Vector
    forward: Vector
    tan_half: tuple[float, float]
    target_distance: float

    def resized(self, height: int, width: int) -> "Pinhole":
        """The same horizontal field of view with other pixels."""
        if max(height, width) > MAX_SIDE:
            raise InputError(f"size {width}x{height}: expected at most {MAX_SIDE} pixels a side")
        tan_x = self.tan_half[0]
        return replace(self, width=width, height=height, tan_half=(tan_x, tan_x * height / width))


@dataclass(frozen=True)
class Surface:
    """A matt parallelogram, corner + u·edge_u + v·edge_v; `normal` is a unit vector on the camera's side."""

    name: str
    corner: Vector
    edge_u: Vector
    edge_v: Vector
    normal: Vector
    material: Material

    @property
    def area(self) -> float:
        return float(np.linalg.norm(np.cross(self.edge_u, self.edge_v)))

    @property
    def corners(self) -> Vector:
        """(4, 3), around the outline."""
        return np.array([self.at(u, v) for u, v in ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))])

    def at(self, u: Any, v: Any) -> Vector:
        """Points (…, 3) at u, v (…)."""
        point = self.corner + np.asarray(u)[..., None] * self.edge_u + np.asarray(v)[..., None] * self.edge_v
        return np.asarray(point)


@dataclass(frozen=True)
class Scene:
    """A whole room; see the module's text for units."""

    name: str
    projector: Pinhole
    camera: Pinhole
    brightness: float
    black_level: float
    response: Response
    ambient_irradiance: Vector
    surfaces: tuple[Surface, ...]
    samples: int
    cells: int


def load_scene(path: Path) -> Scene:
    """Read and check a scene file; InputError naming file, table and key for anything wrong."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such scene file; the shipped ones are in calib_data/scenes") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: not a readable TOML file ({error})") from None
    top = _Table(table, f"{path}")
    projector, camera = top.table("projector"), top.table("camera")
    ambient = top.table("ambient", optional=True)
    eye = _pinhole(camera)
    surfaces = tuple(_surface(entry, path.parent, eye.position) for entry in top.tables("surfaces"))
    scene = Scene(
        name=top.text("name", path.stem),
        projector=_pinhole(projector),
        camera=eye,
        brightness=projector.number("brightness", 1.0, 1e-6, 1e6),
        black_level=projector.number("black_level", 0.0, 0.0, 1.0),
        response=projector.response(),
        ambient_irradiance=ambient.vector("irradiance", (0.0, 0.0, 0.0), low=0.0),
        surfaces=surfaces,
        samples=top.integer("samples", 4, 1, MAX_SAMPLES),
        cells=top.integer("cells", 600, 2, MAX_CELLS),
    )
    for part in (top, projector, camera, ambient):
        part.refuse_unknown()
    return scene


def _pinhole(table: "_Table") -> Pinhole:
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
    tan_half = tan_x, tan_x * height / width
    return Pinhole(width, height, position, right, np.cross(right, forward), forward, tan_half, distance)


def _surface(table: "_Table", folder: Path, eye: Vector) -> Surface:
    name = table.text("name", table.where.rpartition(": ")[2])
    corner, edge_u, edge_v = (table.vector(key) for key in ("corner", "edge_u", "edge_v"))
    normal = np.cross(edge_u, edge_v)
    if np.linalg.norm(normal) < 1e-12:
        raise InputError(f"{table.where}: edge_u and edge_v span no area; give two edges that are not parallel")
    normal = normal / np.linalg.norm(normal)
    facing = float(normal @ (eye - corner))
    material = _material(table, folder)
    table.refuse_unknown()
    return Surface(name, corner, edge_u, edge_v, normal if facing >= 0 else -normal, material)


def _material(table: "_Table", folder: Path) -> Material:
    kinds = [key for key in ("albedo", "texture", "pattern") if key in table.values]
    if len(kinds) != 1:
        raise InputError(
            f"{table.where}: found {' and '.join(kinds) or 'none'}, expected one of albedo, texture, pattern"
        )
    if kinds == ["albedo"]:
        return PlainColour(table.colour("albedo"))
    if kinds == ["texture"]:
        return Texture(read_texture(folder / table.text("texture", None), f"{table.where}, texture"))
    pattern = table.table("pattern")
    kind = pattern.text("kind", None)
    if kind not in PATTERNS:
        raise InputError(f"{pattern.where}, kind: found {kind!r}, expected one of {', '.join(PATTERNS)}")
    colours = pattern.colours("colours")
    repeat = pattern.numbers("repeat", 2, (8.0, 8.0), 1e-3, 1e4)
    result = Pattern(kind, colours, (float(repeat[0]), float(repeat[1])), pattern.number("variation", 0.0, 0.0, 1.0))
    pattern.refuse_unknown()
    return result


class _Table:
    """A TOML table with checked access, remembering which keys were asked for."""

    def __init__(self, values: Mapping[str, Any], where: str) -> None:
        self.values, self.where = values, where
        self._known: set[str] = set()

    def table(self, key: str, *, optional: bool = False) -> "_Table":
        value = self._get(key, {} if optional else None)
        if not isinstance(value, dict):
            raise InputError(f"{self.where}: needs a table [{key}]")
        return _Table(value, f"{self.where}: [{key}]")

    def tables(self, key: str) -> list["_Table"]:
        value = self._get(key, None)
        if not (isinstance(value, list) and value and all(isinstance(entry, dict) for entry in value)):
            raise InputError(f"{self.where}: needs at least one [[{key}]]")
        return [_Table(entry, f"{self.where}: {key} {index}") for index, entry in enumerate(value, 1)]

    def text(self, key: str, default: str | None) -> str:
        value = self._get(key, default)
        if not isinstance(value, str):
            raise InputError(f"{self.where}, {key}: found {value!r}, expected a text")
        return value

    def number(self, key: str, default: float | None, low: float, high: float) -> float:
        return float(self.numbers(key, 1, None if default is None else (default,), low, high)[0])

    def integer(self, key: str, default: int | None, low: int, high: int) -> int:
        value = self._get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise InputError(f"{self.where}, {key}: found {value!r}, expected a whole number from {low} to {high}")
        return value

    def vector(self, key: str, default: tuple[float, ...] | None = None, low: float = -1e6) -> Vector:
        return self.numbers(key, 3, default, low, 1e6)

    def colour(self, key: str) -> Vector:
        return self.numbers(key, 3, None, 0.0, 1.0)

    def colours(self, key: str) -> Vector:
        value = self._get(key, None)
        if not (isinstance(value, list) and len(value) == 2):
            raise InputError(f"{self.where}, {key}: found {value!r}, expected two colours [[r, g, b], [r, g, b]]")
        return np.array([_Table({key: colour}, self.where).colour(key) for colour in value])

    def numbers(self, key: str, count: int, default: tuple[float, ...] | None, low: float, high: float) -> Vector:
        value = self._get(key, default)
        listed = [value] if count == 1 and not isinstance(value, list | tuple) else value
        numeric = isinstance(listed, list | tuple) and all(
            isinstance(v, int | float) and not isinstance(v, bool) and low <= v <= high for v in listed
        )
        if not numeric or len(listed) != count:
            wanted = "a number" if count == 1 else f"{count} numbers"
            raise InputError(f"{self.where}, {key}: found {value!r}, expected {wanted} from {low:g} to {high:g}")
        return np.array(listed, np.float64)

    def response(self) -> Response:
        try:
            return parse_response(self._get("response", "linear"))
        except InputError as error:
            raise InputError(f"{self.where}: {error}") from None

    def refuse_unknown(self) -> None:
        """InputError for keys that nobody asked for."""
        for key in self.values:
            if key not in self._known:
                near = difflib.get_close_matches(key, self._known, 1, 0.4)
                hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(sorted(self._known))}"
                raise InputError(f"{self.where}: unknown key {key!r}; {hint}")

    def _get(self, key: str, default: Any) -> Any:
        self._known.add(key)
        value = self.values.get(key, default)
        if value is None:
            self._suggest(key)
        return value

    def _suggest(self, key: str) -> None:
        near = difflib.get_close_matches(key, [other for other in self.values if other not in self._known], 1, 0.6)
        hint = f"; is {near[0]!r} meant to be it?" if near else ""
        raise InputError(f"{self.where}: needs {key}{hint}")
