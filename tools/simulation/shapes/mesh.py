"""Meshes from Wavefront OBJ files: v, vt, vn and f lines; polygons become fans of triangles."""

from array import array
from io import BytesIO
from pathlib import Path

import numpy as np

from counterlight.arrays import FloatArray, IntArray
from counterlight.errors import InputError, one_line
from counterlight.files.reading import read_bytes
from counterlight.tools.simulation.shapes.triangles import Triangles

MAX_BYTES = 256 << 20
MAX_TRIANGLES, LONGEST_LINE = 1 << 22, 1 << 16
FARTHEST = 1e6  # largest coordinate of a vertex, in metres
LISTS = {"v": 3, "vt": 2, "vn": 3}  # numbers per entry
NONE = -1  # stands for a missing index


def read_obj(path: Path, where: str, at: FloatArray, scale: float) -> Triangles:
    """Read a mesh; vertices are scaled, then moved to `at`.

    Without texture coordinates every place is (0, 0). Without normals the facets are flat.

    Raises InputError starting with `where` for anything that is not a mesh.
    """
    try:
        lists, corners = _parsed(read_bytes(path, MAX_BYTES, "check the path, or simplify the mesh"))
        with np.errstate(over="ignore"):  # overflow becomes infinite, and is refused
            return _mesh(lists, corners, at, scale)
    except ValueError as error:
        raise InputError(f"{where}: {path}: {one_line(error)}") from None
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _mesh(lists: dict[str, FloatArray], corners: IntArray, at: FloatArray, scale: float) -> Triangles:
    if not len(corners):
        raise ValueError("no faces; export it with faces (f lines)")
    used, index = np.unique(corners, axis=0, return_inverse=True)  # one vertex per (v, vt, vn)
    for column, name in enumerate(LISTS):
        if used[:, column].max() >= len(lists[name]) or used[:, column].min() < (0 if name == "v" else NONE):
            raise ValueError(f"a face whose {name} is not there; export the mesh again")
    points = at + scale * lists["v"][used[:, 0]]
    if not np.abs(points).max() <= FARTHEST:
        raise ValueError(f"a vertex beyond {FARTHEST:g} metres; scale the mesh")
    faces = index.reshape(-1, 3).astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0]
    if not len(faces):
        raise ValueError("no face with an area; export the mesh again")
    normals = _unit(_chosen(lists["vn"], used[:, 2])) if used[:, 2].min() >= 0 else None
    closed = _is_closed(corners[:, 0].reshape(-1, 3))
    return Triangles(points, faces, _chosen(lists["vt"], used[:, 1]), normals, closed)


def _unit(normals: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    if not np.all((lengths > 0) & (lengths < np.inf)):
        raise ValueError("a normal without a direction; export the mesh again")
    return np.asarray(normals / lengths)


def _parsed(content: bytes) -> tuple[dict[str, FloatArray], IntArray]:
    """Returns the lists v, vt and vn, and the corners (v, vt, vn), three per triangle.

    Raises ValueError that names the line.
    """
    lists = {name: array("d") for name in LISTS}
    corners = array("q")
    for number, line in enumerate(BytesIO(content), 1):
        try:
            if len(line) > LONGEST_LINE:
                raise ValueError(f"{len(line)} bytes, at most {LONGEST_LINE} are read")
            key, *fields = line.split(b"#")[0].split() or [b""]
            if (name := key.decode("ascii", "replace")) in LISTS:
                lists[name].extend(_numbers(fields, LISTS[name]))
            elif key == b"f":
                counts = {name: len(values) // LISTS[name] for name, values in lists.items()}
                polygon = [_corner(field, counts) for field in fields]
                for k in range(1, len(polygon) - 1):
                    for corner in (polygon[0], *polygon[k : k + 2]):
                        corners.extend(corner)
                if len(corners) > 9 * MAX_TRIANGLES:
                    raise ValueError(f"more than {MAX_TRIANGLES} triangles; simplify the mesh")
        except (ValueError, OverflowError) as error:
            raise ValueError(f"line {number}: {error}; export the mesh again") from None
    arrays = {name: np.array(values).reshape(-1, LISTS[name]) for name, values in lists.items()}
    return arrays, np.array(corners, np.int64).reshape(-1, 3)


def _numbers(fields: list[bytes], count: int) -> list[float]:
    numbers = [float(field) for field in fields[:count]]
    if len(numbers) != count or not np.all(np.isfinite(numbers)):
        raise ValueError(f"{count} finite numbers expected")
    return numbers


def _corner(field: bytes, counts: dict[str, int]) -> tuple[int, ...]:
    """Convert `7/3/2`, `7//2` or `7`, counted from 1, or from the end if negative, to indices from 0."""
    parts = [*field.split(b"/"), b"", b""][:3]
    return tuple(
        (int(part) - 1 if int(part) > 0 else max(counts[name] + int(part), NONE - 1)) if part else NONE
        for part, name in zip(parts, LISTS, strict=True)
    )


def _chosen(values: FloatArray, index: IntArray) -> FloatArray:
    if not len(values) or index.min() < 0:
        return np.zeros((len(index), values.shape[1]))
    return np.asarray(values[index])


def _is_closed(faces: IntArray) -> bool:
    """Returns whether every edge has exactly two faces, one in each direction."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward = np.unique(edges, axis=0)
    return len(forward) == len(edges) and np.array_equal(forward, np.unique(edges[:, ::-1], axis=0))
