"""Evenly spread points and tangent vectors for effects that draw directions; the same in every run."""

import numpy as np

from counterlight.arrays import FloatArray

PLASTIC = 1.32471795724474602596  # x³ = x + 1


def even_pairs(count: int) -> FloatArray:
    """Returns (count, 2) numbers in 0..1; any run of them fills the square evenly (the R₂ sequence, Roberts 2018)."""
    steps = np.array([1 / PLASTIC, 1 / PLASTIC**2])
    return np.asarray((0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0)


def tangents(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns two unit vectors (n, 3) that are perpendicular to each unit normal and to each other."""
    thin = np.abs(normals[:, 0]) > 0.9
    helper = np.where(thin[:, None], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)
