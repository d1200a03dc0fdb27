"""Find which projector pixel each camera pixel sees, from the brightness of pairs over time.

Each camera pixel sees one sequence of colours, one colour per pair. Standardised over the pairs, this sequence depends
neither on the surface nor on ambient light, so it identifies the projector pixel. A coarse search gives a homography,
and Gauss-Newton steps on smooth displacements refine it from coarse to fine pictures.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import FloatArray
from counterlight.errors import InputError

Pictures = NDArray[np.floating]  # (pairs, height, width, 3)
COARSE = 40  # cells of the coarse search along the longer side
CLEAR, LEAST_MATCHES = 0.6, 24  # correlation of a reliable match of cells, and how many are needed
NO_MATCH = "the photographs do not show these pictures; check that they belong together, or list the pairs with --pairs"
SCALES = {8: 5, 4: 4, 2: 3, 1: 2}  # and Gauss-Newton steps at each
MOST_PAIRS = 24  # pairs that refine places
WINDOW = 5.0  # standard deviation in camera pixels of the neighbourhood that determines a displacement
LATERAL = 30.0  # standard deviation for displacements of single primaries
MOST_STEP = 2.0  # pixels by which a step may move a place
STIFF = 2e-3  # share of the mean information that holds a displacement where the pictures are flat


@dataclass(frozen=True)
class Places:
    """The projector pixels that camera pixels see.

    places : (3, height, width, 2) float32. (x, y) in projector pixels per primary and camera pixel.
    """

    places: NDArray[np.floating]

    def warped(self, picture: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return the picture as the camera sees it without blur, (height, width, 3)."""
        return np.stack([looked_up(picture[..., k], self.places[k]) for k in range(3)], axis=-1)


def looked_up(picture: NDArray[np.floating], places: NDArray[np.floating]) -> NDArray[np.floating]:
    """Interpolate a picture at (height, width, 2) places; zero outside the picture."""
    return np.asarray(cv2.remap(picture, places[..., 0], places[..., 1], cv2.INTER_LINEAR))


def find_places(light: Pictures, captures: Pictures) -> Places:
    """Find the places of all camera pixels.

    light : the projector pictures in linear light, (pairs, projector height, projector width, 3).
    captures : their captures, (pairs, camera height, camera width, 3).
    """
    homography = _coarse(light, captures)
    light, captures = _some(light), _some(captures)
    height, width = captures.shape[1:3]
    places = _seen_by(homography, (height, width))
    for scale, steps in SCALES.items():
        small = (max(width // scale, 8), max(height // scale, 8))
        shrunk = np.array([max(light.shape[2] // scale, 8), max(light.shape[1] // scale, 8)])
        ratio = shrunk / np.array([light.shape[2], light.shape[1]])
        few = np.stack([cv2.resize(each, tuple(shrunk), interpolation=cv2.INTER_AREA) for each in light])
        seen = np.stack([cv2.resize(each, small, interpolation=cv2.INTER_AREA) for each in captures])
        here = _resized(places, small, ratio)
        for _ in range(steps):
            here = here + step(few, seen, np.repeat(here[None], 3, axis=0))
        places = places + _resized(here - _resized(places, small, ratio), (width, height), 1 / ratio, vectors=True)
    return Places(np.repeat(places[None], 3, axis=0).astype(np.float32))


def _resized(
    places: NDArray[np.floating], size: tuple[int, int], ratio: FloatArray, *, vectors: bool = False
) -> NDArray[np.floating]:
    """Resize a field of places or vectors to (width, height), and its values by `ratio`, with pixel centres kept."""
    resized = cv2.resize(places, size, interpolation=cv2.INTER_LINEAR)
    moved = resized * ratio if vectors else (resized + 0.5) * ratio - 0.5
    return moved.astype(np.float32)


def refined(light: Pictures, captures: Pictures, found: Places, steps: int = 2) -> Places:
    """Improve the places of all primaries together, and then of each primary, by smooth displacements."""
    places = found.places
    light, captures = _some(light), _some(captures)
    for _ in range(steps):
        places = places + step(light, captures, places)
        places = np.stack([places[k] + step(light, captures, places, [k], LATERAL) for k in range(3)])
    return Places(places)


def _some(pictures: Pictures) -> Pictures:
    """Return at most MOST_PAIRS pictures, evenly spaced."""
    return np.asarray(pictures[np.unique(np.linspace(0, len(pictures) - 1, MOST_PAIRS).astype(int))])


def _seen_by(homography: FloatArray, shape: tuple[int, int]) -> NDArray[np.floating]:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    points = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    return np.asarray(cv2.perspectiveTransform(points, homography).reshape(*shape, 2).astype(np.float32))


def standardised(pictures: Pictures) -> NDArray[np.floating]:
    """Return each pixel's values over the pairs as vectors of length 1 without mean: (pixels, 3 · pairs)."""
    values = pictures - pictures.mean(axis=0)
    vectors = values.transpose(1, 2, 3, 0)
    vectors = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
    return np.ascontiguousarray(vectors.reshape(-1, 3 * len(pictures)) / np.sqrt(3)).astype(np.float32)


def _reduced(pictures: Pictures) -> Pictures:
    height, width = pictures.shape[1:3]
    scale = COARSE / max(height, width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.stack([cv2.resize(np.sqrt(np.maximum(each, 0)), size, interpolation=cv2.INTER_AREA) for each in pictures])


def _coarse(light: Pictures, captures: Pictures) -> FloatArray:
    """Return the homography from camera pixels to projector pixels that a search over all pairs of cells suggests."""
    few, seen = _reduced(light), _reduced(captures)
    likeness = standardised(seen) @ standardised(few).T
    best = likeness.argmax(axis=1)
    clear = likeness.max(axis=1) > CLEAR
    if clear.sum() < LEAST_MATCHES:
        raise InputError(NO_MATCH)
    to = np.stack(np.divmod(best, few.shape[2])[::-1], axis=-1) + 0.5
    at = np.stack(np.divmod(np.arange(len(best)), seen.shape[2])[::-1], axis=-1) + 0.5
    to *= np.array(light.shape[2:0:-1]) / np.array(few.shape[2:0:-1])
    at *= np.array(captures.shape[2:0:-1]) / np.array(seen.shape[2:0:-1])
    cell = light.shape[2] / few.shape[2]
    found, _ = cv2.findHomography(at[clear] - 0.5, to[clear] - 0.5, cv2.RANSAC, 2 * cell)
    if found is None:
        raise InputError(NO_MATCH)
    return np.asarray(found)


def _smooth(field: FloatArray, sigma: float) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(field, (0, 0), sigma, borderType=cv2.BORDER_REFLECT))


def regression(x: NDArray[np.floating], y: NDArray[np.floating]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return slope, offset and correlation of y over x along the first axis."""
    mx, my = x.mean(axis=0), y.mean(axis=0)
    xx = np.einsum("n...,n...->...", x, x) / len(x) - mx**2
    xy = np.einsum("n...,n...->...", x, y) / len(x) - mx * my
    yy = np.einsum("n...,n...->...", y, y) / len(x) - my**2
    slope = xy / np.maximum(xx, 1e-9)
    return slope, my - slope * mx, xy / np.sqrt(np.maximum(xx * yy, 1e-18))


def step(
    light: Pictures,
    seen: Pictures,
    places: NDArray[np.floating],
    primaries: Sequence[int] = (0, 1, 2),
    window: float = WINDOW,
) -> NDArray[np.floating]:
    """Return one Gauss-Newton step of the places, (height, width, 2), from these primaries together."""
    sums = np.zeros((5, *seen.shape[1:3]))
    for k in primaries:
        shown = np.stack([looked_up(each[..., k], places[k]) for each in light])
        slope, offset, clarity = regression(shown, seen[..., k])
        weight = (np.clip(clarity, 0, 1) ** 4 * (slope > 0)).astype(np.float32)
        rest = np.where(weight > 0, (seen[..., k] - offset) / np.maximum(slope, 1e-3), shown) - shown
        limit = 4 * np.median(np.abs(rest[:, weight > 0.1])) if (weight > 0.1).any() else 1.0
        rest = np.clip(rest, -limit, limit)
        dx = np.stack([looked_up(np.gradient(each[..., k], axis=1), places[k]) for each in light])
        dy = np.stack([looked_up(np.gradient(each[..., k], axis=0), places[k]) for each in light])
        dx -= dx.mean(axis=0) + _slope(dx, shown) * (shown - shown.mean(axis=0))
        dy -= dy.mean(axis=0) + _slope(dy, shown) * (shown - shown.mean(axis=0))
        for number, (a, b) in enumerate(((dx, dx), (dx, dy), (dy, dy), (dx, rest), (dy, rest))):
            sums[number] += weight * np.einsum("nyx,nyx->yx", a, b)
    xx, xy, yy, xr, yr = (_smooth(each, window) for each in sums)
    stiff = STIFF * (xx + yy).mean()
    xx, yy = xx + stiff, yy + stiff
    det = xx * yy - xy**2
    step = np.stack([yy * xr - xy * yr, xx * yr - xy * xr], axis=-1) / det[..., None]
    return np.asarray(np.clip(step, -MOST_STEP, MOST_STEP).astype(np.float32))


def _slope(x: NDArray[np.floating], y: NDArray[np.floating]) -> FloatArray:
    return regression(y, x)[0]
