"""Meshes from Wavefront OBJ files: v, vt, vn and f lines; polygons become fans of triangles."""

from pathlib import Path

import numpy as np

from player.errors import InputError
from tools.simulation.shapes.shape import FloatArray, IntArray
from tools.simulation.shapes.triangles import Triangles

MAX_BYTES = 256 << 20


def read_obj(path: Path, where: str, at: FloatArray, scale: float) -> Triangles:
    """Vertices are scaled, then moved to `at`. InputError starting with `where` for anything that is no mesh.

    Without texture coordinates every place is (0, 0); without normals the facets are flat.
    """
    corners, lists = _parsed(path, where)
    if not corners:
        raise InputError(f"{where}: {path} has no faces; export it with faces (f lines)")
    used, index = np.unique(np.array(corners), axis=0, return_inverse=True)  # one vertex per (v, vt, vn)
    for column, name in enumerate(("v", "vt", "vn")):
        if used[:, column].max() >= len(lists[name]) or (column == 0 and used[:, 0].min() < 0):
            raise InputError(f"{where}: {path} has a face whose {name} is not there; export the mesh again")
    points = at + scale * np.array(lists["v"], np.float64)[used[:, 0]]
    faces = index.reshape(-1, 3).astype(np.int64)
    a, b, c = (points[faces[:, k]] for k in range(3))
    faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0]
    places = _chosen(lists["vt"], used[:, 1], 2)
    normals = None
    if used[:, 2].min() >= 0:
        normals = _chosen(lists["vn"], used[:, 2], 3)
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return Triangles(points, faces, places, normals, _is_closed(np.array(corners)[:, 0].reshape(-1, 3)))


def _parsed(path: Path, where: str) -> tuple[list[tuple[int, int, int]], dict[str, list[list[float]]]]:
    """Corners (v, vt, vn), three a triangle, −1 for none, and the lists that they point into."""
    lists: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    corners: list[tuple[int, int, int]] = []
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{where}: {path} has more than {MAX_BYTES >> 20} MiB; simplify the mesh")
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
            key, *fields = line.split("#")[0].split() or [""]
            try:
                if key in lists:
                    count = 2 if key == "vt" else 3
                    lists[key].append([float(field) for field in fields[:count]])
                    if len(lists[key][-1]) != count or not np.all(np.isfinite(lists[key][-1])):
                        raise ValueError(f"{count} finite numbers expected")
                elif key == "f":
                    polygon = [_corner(field, lists) for field in fields]
                    corners += [
                        corner for k in range(1, len(polygon) - 1) for corner in (polygon[0], *polygon[k : k + 2])
                    ]
            except ValueError as error:
                raise InputError(f"{where}: {path}, line {number}: {error}; export the mesh again") from None
    except OSError as error:
        raise InputError(f"{where}: {path}: {error.strerror}; check the path") from None
    return corners, lists


def _corner(field: str, lists: dict[str, list[list[float]]]) -> tuple[int, int, int]:
    """`7/3/2`, `7//2` or `7`, counted from 1, or from the end if negative -> indices from 0."""
    parts = [*field.split("/"), "", ""][:3]
    v, vt, vn = (
        (int(part) - 1 if int(part) > 0 else len(lists[name]) + int(part)) if part else -1
        for part, name in zip(parts, ("v", "vt", "vn"), strict=True)
    )
    return v, vt, vn


def _chosen(values: list[list[float]], index: IntArray, width: int) -> FloatArray:
    if not values or index.min() < 0:
        return np.zeros((len(index), width))
    return np.asarray(np.array(values, np.float64)[index])


def _is_closed(faces: IntArray) -> bool:
    """Does every edge have exactly two faces, one in each direction?"""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward = {tuple(edge) for edge in edges.tolist()}
    return len(forward) == len(edges) and all((b, a) in forward for a, b in forward)
