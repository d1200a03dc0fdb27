"""Identify by content which picture each photograph shows.

Local features of one photograph and its picture give a homography. Seen through the homography, the photographs and
the pictures are standardised pixel by pixel, which removes the surface, and assigned for the largest sum of
correlations. The mean photograph divides each photograph before features are looked for, for the same reason.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from counterlight.arrays import FloatArray, IntArray

SIDE = 400  # longer side of the pictures in which features are looked for
GRID = 40, 30  # (width, height) in which pictures are compared
RATIO, LEAST_INLIERS = 0.75, 15
TRIED = 6  # photographs
CERTAIN = 0.5  # correlation of a photograph and its picture


def matched(pictures: Sequence[NDArray[np.floating]], captures: Sequence[NDArray[np.floating]]) -> IntArray | None:
    """Return the number of each capture's picture, −1 for a capture without a picture; None if no geometry is found.

    pictures, captures : code values or gamma-encoded light, 0 to 1, (height, width, 3) each.
    """
    small = [_small(each) for each in pictures]
    homography = _geometry(small, [_small(each) for each in captures])
    if homography is None:
        return None
    shown = [cv2.resize(each, GRID, interpolation=cv2.INTER_AREA) for each in small]
    size = small[0].shape[1::-1]
    warped = [cv2.warpPerspective(_small(each), homography, size, flags=cv2.INTER_AREA) for each in captures]
    seen = [cv2.resize(each, GRID, interpolation=cv2.INTER_AREA) for each in warped]
    likeness = _standard(np.array(seen)) @ _standard(np.array(shown)).T
    rows, columns = linear_sum_assignment(-likeness)
    result = np.full(len(captures), -1)
    result[rows] = np.where(likeness[rows, columns] > CERTAIN, columns, -1)
    return result


def _small(picture: NDArray[np.floating]) -> NDArray[np.floating]:
    scale = SIDE / max(picture.shape[:2])
    size = (max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale)))
    return np.asarray(cv2.resize(np.asarray(picture, np.float32), size, interpolation=cv2.INTER_AREA))


def _standard(pictures: FloatArray) -> FloatArray:
    """Remove each pixel's mean over the pictures, divide by its deviation, and scale each picture to length 1."""
    values = (pictures - pictures.mean(axis=0)) / np.maximum(pictures.std(axis=0), 0.02)
    flat = values.reshape(len(values), -1)
    flat = flat - flat.mean(axis=1, keepdims=True)
    return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9))


def _geometry(pictures: Sequence[NDArray[np.floating]], captures: Sequence[NDArray[np.floating]]) -> FloatArray | None:
    """Return the homography from captures to pictures that has most features on its side."""
    sift = cv2.SIFT.create(nfeatures=600)
    mean = np.maximum(np.mean(captures, axis=0), 0.02)
    known = [sift.detectAndCompute(_grey(each), None) for each in pictures]
    best: tuple[int, FloatArray | None] = (LEAST_INLIERS - 1, None)
    for number in np.unique(np.linspace(0, len(captures) - 1, TRIED).astype(int)):
        divided = captures[number] / mean
        points, vectors = sift.detectAndCompute(_grey(divided / np.percentile(divided, 99)), None)
        for others, other_vectors in known:
            if vectors is None or other_vectors is None or min(len(points), len(others)) < LEAST_INLIERS:
                continue
            near = cv2.BFMatcher().knnMatch(vectors, other_vectors, k=2)
            good = [a for a, b in near if a.distance < RATIO * b.distance]
            if len(good) <= best[0]:
                continue
            at = np.array([points[m.queryIdx].pt for m in good])
            to = np.array([others[m.trainIdx].pt for m in good])
            found, inside = cv2.findHomography(at, to, cv2.RANSAC, 6.0)
            if found is not None and int(inside.sum()) > best[0]:
                best = (int(inside.sum()), np.asarray(found, np.float64))
    return best[1]


def _grey(picture: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.asarray(np.clip(picture.mean(axis=-1) * 255, 0, 255), np.uint8)
