"""Smooth and hostile transports in correct pixel order, for tests that detect swapped sizes."""

from collections.abc import Callable

import numpy as np
from scipy import sparse

from counterlight.tools.transport.transport import Csr

Shape = tuple[int, int]


def smooth(
    rng: np.random.Generator,
    camera: Shape,
    projector: Shape,
    *,
    tilt: float = 0.2,
    cover: float = 1.0,
    blur: float = 0.4,
) -> Csr:
    """Painted plane between a random camera and a random projector, (camera pixels, projector pixels).

    tilt : tilt of the homography between their pictures.
    cover : projector pictures across the camera picture.
    blur : standard deviation of a footprint in projector pixels.
    """
    y, x = np.mgrid[: camera[0], : camera[1]]
    u, v = (x.ravel() + 0.5) / camera[1] - 0.5, (y.ravel() + 0.5) / camera[0] - 0.5
    a = rng.uniform(-tilt, tilt, 6)
    depth = 1 + a[0] * u + a[1] * v
    across = ((((1 + a[2]) * u + a[3] * v) / depth) * cover + 0.5) * projector[1] - 0.5
    down = ((((1 + a[4]) * v + a[5] * u) / depth) * cover + 0.5) * projector[0] - 0.5
    reach = np.arange(-int(np.ceil(2.5 * blur)), int(np.ceil(2.5 * blur)) + 1)
    rows, columns, weights = [], [], []
    for dy in reach:
        for dx in reach:
            py, px = np.rint(down).astype(int) + dy, np.rint(across).astype(int) + dx
            light = np.exp(-((px - across) ** 2 + (py - down) ** 2) / (2 * blur**2))
            there = (px >= 0) & (px < projector[1]) & (py >= 0) & (py < projector[0]) & (light > 1e-3)
            rows.append(np.flatnonzero(there))
            columns.append((py * projector[1] + px)[there])
            weights.append((light * rng.uniform(0.1, 1, u.size))[there])
    entries = np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))
    return Csr(sparse.coo_array(entries, shape=(u.size, projector[0] * projector[1])))


def rows_of(T: Csr, camera: Shape, order: Callable[[np.ndarray], np.ndarray]) -> Csr:
    """Reorder the rows of T by a function of the picture of camera pixel numbers."""
    return Csr(T[order(np.arange(T.shape[0]).reshape(camera)).ravel()])


def side_by_side(left: Csr, right: Csr, each: Shape) -> Csr:
    """Two projectors of the same size in one raster."""
    numbers = np.arange(each[0] * each[1]).reshape(each)
    return Csr(sparse.hstack([left, right]).tocsr()[:, np.hstack([numbers, numbers.size + numbers]).ravel()])


def radius(shape: Shape) -> np.ndarray:
    """Distance of each pixel from the picture's centre, in widths: (pixels,)."""
    y, x = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    return np.hypot(y - shape[0] / 2, x - shape[1] / 2) / shape[1]


def right_ones(rng: np.random.Generator, camera: Shape, projector: Shape) -> dict[str, tuple[Csr, Shape, Shape]]:
    """T, camera and projector by kind: some smooth, some rough, none smooth for swapped sizes."""
    (height, width), (n, m) = camera, (camera[0] * camera[1], projector[0] * projector[1])
    T, other = (smooth(rng, camera, projector) for _ in range(2))
    odd = ((np.arange(n) // width + np.arange(n) % width) % 2).astype(float)
    y, x = np.divmod(np.arange(n), width)
    far = np.exp(-4 * np.square(radius(camera)[:, None] - radius(projector)))
    rough = sparse.random_array((n, m), density=0.05, rng=rng)
    line, column = (np.zeros((n, *projector)) for _ in range(2))
    line[np.arange(n), y * projector[0] // height] = 1
    column[np.arange(n), :, x * projector[1] // width] = 1
    square = (projector[0], projector[0])
    plain: dict[str, Csr | np.ndarray | sparse.sparray] = {
        "smooth": T,
        "blurred": smooth(rng, camera, projector, blur=rng.uniform(0.5, 4)),
        "steep": smooth(rng, camera, projector, tilt=0.7),
        "small part of the projector's picture": smooth(rng, camera, projector, cover=rng.uniform(0.1, 1)),
        "projector's picture in a dark room": smooth(rng, camera, projector, cover=rng.uniform(1, 3)),
        "with noise": T + 0.02 * sparse.random_array((n, m), density=0.3, rng=rng),
        "half of the rows noise": sparse.diags_array(1 - odd) @ T + sparse.diags_array(odd) @ rough,
        "every second pixel dark": sparse.diags_array(odd) @ T,
        "with far light": T + 0.05 * far,
        "far light": far,
        "sparse noise": rough,
        "dense noise": rng.random((n, m)),
        "all entries equal": np.ones((n, m)),
        "rank 1": np.outer(rng.random(n), rng.random(m)),
        "rows permuted": T[rng.permutation(n)],
        "columns permuted": T[:, rng.permutation(m)],
        "lines permuted": rows_of(T, camera, lambda number: number[rng.permutation(height)]),
        "columns of pixels permuted": rows_of(T, camera, lambda number: number[:, rng.permutation(width)]),
        "turned": rows_of(T, camera, lambda number: number[::-1, ::-1]),
        "interlaced": rows_of(T, camera, lambda number: np.concatenate([number[::2], number[1::2]])),
        "shifted": rows_of(T, camera, lambda number: np.roll(number, width // 3, 1)),
        "mirror": rows_of(T, camera, lambda number: np.minimum(number, number[:, ::-1])),
        "lines of light": line.reshape(n, m),
        "columns of light": column.reshape(n, m),
    }
    raster = projector[0], 2 * projector[1]
    alternating = side_by_side(Csr(sparse.diags_array(odd) @ T), Csr(sparse.diags_array(1 - odd) @ other), projector)
    squares = side_by_side(smooth(rng, camera, square, tilt=0.05), smooth(rng, camera, square, tilt=0.05), square)
    return {name: (Csr(each), camera, projector) for name, each in plain.items()} | {
        "two projectors": (side_by_side(T, other, projector), camera, raster),
        "two projectors, pixel by pixel": (alternating, camera, raster),
        "two square projectors": (squares, camera, (square[0], 2 * square[1])),
        "two cameras": (Csr(sparse.vstack([T, other])), (2 * height, width), projector),
        "one column": (smooth(rng, camera, (max(projector) * 3, 1)), camera, (max(projector) * 3, 1)),
        "one row": (smooth(rng, camera, (1, max(projector) * 3)), camera, (1, max(projector) * 3)),
        "a camera of one column": (smooth(rng, (max(camera) * 3, 1), projector), (max(camera) * 3, 1), projector),
        "tiny": (smooth(rng, (4, 3), (3, 5)), (4, 3), (3, 5)),
    }
