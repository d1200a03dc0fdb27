"""A surface's shape from its table in the scene file; the docstring of tools/simulation/scene.py lists the keys."""

import importlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.files.tables import Table, Vector
from counterlight.tools.simulation.shapes.parallelogram import Parallelogram
from counterlight.tools.simulation.shapes.quadrics import Cylinder, Sphere
from counterlight.tools.simulation.shapes.shape import Shape

KINDS = ("plane", "card", "sphere", "cylinder", "relief", "lathe", "mesh")
FIGURES = ("statuette", "skull", "waves", "bricks")
SIZE = (1e-4, 1e4)  # smallest and largest size of a shape, in metres
MOST_POINTS = 1 << 22


def read_shapes(table: Table, folder: Path, eye: Vector) -> list[tuple[str, Shape]]:
    """Returns a surface's shapes, each with a suffix for its name (a card has two shapes).

    eye : the camera's position; fronts are on its side.
    """
    kind = table.choice("shape", KINDS, "plane")
    readers: dict[str, Callable[[Table, Path, Vector], Shape]] = {
        "plane": _plane,
        "sphere": _sphere,
        "cylinder": _cylinder,
        "relief": _relief,
        "lathe": _lathe,
        "mesh": _mesh,
    }
    if kind == "card":
        return _card(table, eye)
    return [("", readers[kind](table, folder, eye))]


def _facing(table: Table, corner: Vector, edge_u: Vector, edge_v: Vector, eye: Vector) -> Parallelogram:
    normal = np.cross(edge_u, edge_v)
    if np.linalg.norm(normal) < 1e-12:
        raise InputError(f"{table.where}: edge_u and edge_v span no area; give two edges that are not parallel")
    normal = normal / np.linalg.norm(normal)
    return Parallelogram(corner, edge_u, edge_v, normal if normal @ (eye - corner) >= 0 else -normal)


def _plane(table: Table, folder: Path, eye: Vector) -> Parallelogram:
    corner, edge_u, edge_v = (table.vector(key) for key in ("corner", "edge_u", "edge_v"))
    return _facing(table, corner, edge_u, edge_v, eye)


def _card(table: Table, eye: Vector) -> list[tuple[str, Shape]]:
    corner, fold = table.vector("corner"), table.vector("fold")
    wings = table.rows("wings", 2, 3, -1e6, 1e6)
    sides = zip((" (first wing)", " (second wing)"), wings, strict=True)
    return [(name, _facing(table, corner, wing, fold, eye)) for name, wing in sides]


def _sphere(table: Table, folder: Path, eye: Vector) -> Sphere:
    return Sphere(table.vector("centre"), table.number("radius", None, *SIZE))


def _cylinder(table: Table, folder: Path, eye: Vector) -> Cylinder:
    axis = table.vector("axis")
    across, deep = _frame(table, axis)
    return Cylinder(table.vector("base"), axis, table.number("radius", None, *SIZE), across, deep)


def _frame(table: Table, axis: Vector) -> tuple[Vector, Vector]:
    length = np.linalg.norm(axis)
    if length < SIZE[0]:
        raise InputError(
            f"{table.where}, axis: found {axis.tolist()}, expected a length of at least {SIZE[0]:g} metres"
        )
    up = axis / length
    across = np.cross(up, [0.0, 0.0, 1.0] if abs(up[2]) < 0.9 else [1.0, 0.0, 0.0])
    across = across / np.linalg.norm(across)
    return across, np.cross(up, across)


def _relief(table: Table, folder: Path, eye: Vector) -> Shape:
    from counterlight.tools.simulation.shapes.triangles import read_heights, relief

    base = _plane(table, folder, eye)
    height = table.number("height", None, *SIZE)
    detail = table.integer("detail", 240, 2, 2000)
    columns, rows = _grid(base, detail)
    if ("figure" in table) == ("heights" in table):
        raise InputError(f"{table.where}: expected one of figure and heights")
    if "figure" in table:
        name = table.choice("figure", FIGURES)
        figure = importlib.import_module(f"counterlight.tools.simulation.shapes.figures.{name}")
        heights = figure.heights(*np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows)))
    else:
        heights = read_heights(table.path("heights", folder), f"{table.where}, heights", columns, rows)
    cut = table.truth("cut", False)
    if cut and not np.any(heights > 0):
        raise InputError(f"{table.where}, cut: the relief has no part above its base; leave cut out")
    return relief(base, height * heights, cut=cut)


def _grid(base: Parallelogram, detail: int) -> tuple[int, int]:
    """Returns the numbers of vertices along u and v: square fields, `detail` of them along the longer edge."""
    lengths = np.linalg.norm(base.edge_u), np.linalg.norm(base.edge_v)
    step = max(lengths) / detail
    columns, rows = (max(2, round(float(length / step))) + 1 for length in lengths)
    return columns, rows


def _lathe(table: Table, folder: Path, eye: Vector) -> Shape:
    from counterlight.tools.simulation.shapes.triangles import turned

    axis = table.vector("axis", (0.0, 1.0, 0.0))
    profile: FloatArray = table.rows("profile", None, 2, -SIZE[1], SIZE[1])
    if profile[:, 0].min() < 0:
        raise InputError(f"{table.where}, profile: a radius is {profile[:, 0].min():g}, expected 0 or more metres")
    detail = table.integer("detail", 96, 3, 2000)
    if len(profile) * detail > MOST_POINTS:
        raise table.wrong("detail", f"at most {MOST_POINTS} points in all, here {len(profile)} times that")
    return turned(table.vector("base"), axis / np.linalg.norm(axis), _frame(table, axis), profile, detail)


def _mesh(table: Table, folder: Path, eye: Vector) -> Shape:
    from counterlight.tools.simulation.shapes.mesh import read_obj

    place = table.vector("at", (0.0, 0.0, 0.0)), table.number("scale", 1.0, 1e-6, 1e6)
    return read_obj(table.path("file", folder), f"{table.where}, file", *place)
