"""Identify by content which picture each photograph shows.

Local features of one photograph and its picture give a homography. Seen through the homography, the photographs and
the pictures are standardised pixel by pixel, which removes the surface, and assigned for the largest sum of
correlations. For the same reason, each photograph is divided by the mean photograph before features are looked for.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from counterlight.arrays import FloatArray, IntArray

SIDE = 400  # longer side of the pictures in which features are looked for
GRID = 40, 30  # (width, height) in which pictures are compared
RATIO, LEAST_INLIERS = 0.75, 15
TRIED = 6  # photographs whose features are compared with a picture
CERTAIN = 0.5  # correlation from which on a photograph certainly shows its picture
PREFERRED = 0.05  # advantage in correlation of the picture with the same number


def matched(
    pictures: Iterable[NDArray[np.floating]], captures: Iterable[NDArray[np.floating]], *, numbered: bool = False
) -> IntArray | None:
    """Return the number of each capture's picture, −1 for a capture without a picture; None if no geometry is found.

    Each picture and capture is read once, and only a small copy is kept.

    pictures, captures : code values or gamma-encoded light, 0 to 1, (height, width, 3) each.
    numbered : whether a capture is matched to the picture with its number when other pictures fit about as well.
    """
    small = [_small(each) for each in captures]
    shown, best, size = [], Geometry(LEAST_INLIERS - 1), None
    described = _described(small)
    for picture in pictures:
        here = _small(picture)
        size = size or here.shape[1::-1]
        shown.append(cv2.resize(here, GRID, interpolation=cv2.INTER_AREA))
        best = max(best, _geometry(here, described, best.inliers), key=lambda each: each.inliers)
    if best.homography is None or size is None:
        return None
    warped = [cv2.warpPerspective(each, best.homography, size, flags=cv2.INTER_AREA) for each in small]
    seen = [cv2.resize(each, GRID, interpolation=cv2.INTER_AREA) for each in warped]
    likeness = _standard(np.stack(seen) / 255) @ _standard(np.stack(shown) / 255).T
    if numbered:
        likeness += PREFERRED * np.eye(*likeness.shape)
    rows, columns = linear_sum_assignment(-likeness)
    result = np.full(len(small), -1)
    result[rows] = np.where(likeness[rows, columns] > CERTAIN, columns, -1)
    return result


@dataclass(frozen=True)
class Geometry:
    """A homography from captures to pictures, and how many features agree with it."""

    inliers: int
    homography: FloatArray | None = None


def _small(picture: NDArray[np.floating]) -> NDArray[np.uint8]:
    scale = SIDE / max(picture.shape[:2])
    size = (max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale)))
    reduced = cv2.resize(np.asarray(picture, np.float32), size, interpolation=cv2.INTER_AREA)
    return np.asarray(np.rint(np.clip(reduced, 0, 1) * 255), np.uint8)


def _standard(pictures: NDArray[np.floating]) -> FloatArray:
    """Remove each pixel's mean over the pictures, divide by its deviation, and scale each picture to length 1."""
    values = (pictures - pictures.mean(axis=0)) / np.maximum(pictures.std(axis=0), 0.02)
    flat = values.reshape(len(values), -1)
    flat = flat - flat.mean(axis=1, keepdims=True)
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9))


Features = tuple[Sequence[cv2.KeyPoint], NDArray[np.floating] | None]


def _described(captures: Sequence[NDArray[np.uint8]]) -> list[Features]:
    """Return the features of some captures, each divided by the mean capture."""
    mean = np.maximum(np.mean(captures, axis=0), 0.02 * 255)
    tried = np.unique(np.linspace(0, len(captures) - 1, TRIED).astype(int))
    divided = [captures[number] / mean for number in tried]
    return [_features(each / max(float(np.percentile(each, 99)), 1e-6)) for each in divided]


def _features(picture: NDArray[np.floating]) -> Features:
    grey = np.asarray(np.clip(picture.mean(axis=-1) * 255, 0, 255), np.uint8)
    points, vectors = cv2.SIFT.create(nfeatures=600).detectAndCompute(grey, None)
    return points, None if vectors is None else np.asarray(vectors, np.float32)


def _geometry(picture: NDArray[np.uint8], described: Sequence[Features], least: int) -> Geometry:
    """Return the homography to a picture that most features of one capture agree with, if more than `least` do."""
    best = Geometry(least)
    others, other_vectors = _features(picture / 255)
    for points, vectors in described:
        if vectors is None or other_vectors is None or min(len(points), len(others)) < LEAST_INLIERS:
            continue
        near = cv2.BFMatcher().knnMatch(vectors, other_vectors, k=2)
        good = [a for a, b in near if a.distance < RATIO * b.distance]
        if len(good) <= best.inliers:
            continue
        at = np.array([points[m.queryIdx].pt for m in good])
        to = np.array([others[m.trainIdx].pt for m in good])
        found, inside = cv2.findHomography(at, to, cv2.RANSAC, 6.0)
        if found is not None and int(inside.sum()) > best.inliers:
            best = Geometry(int(inside.sum()), np.asarray(found, np.float64))
    return best
