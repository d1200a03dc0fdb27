"""The objective as one bounded least squares for scipy: min ½‖A p − a‖², A = [√w T; √η; √ω D], a = [√w b; 0; 0]."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from counterlight.tools.transport.objective import Objective
from counterlight.tools.transport.transport import channel

FloatArray = NDArray[np.float64]


def augmented(objective: Objective, b: FloatArray, i: int) -> tuple[FloatArray, FloatArray]:
    """Returns A, dense, and a for channel i, from near light alone; b is (camera pixels, 3)."""
    root = np.sqrt(objective.weights)
    rows = [root[:, None] * channel(objective.T.near, i).toarray()]
    target = root * objective.bounded(b)[:, i]
    if objective.prior is not None:
        prior = objective.prior
        height, width = prior.damping.shape[:2]
        pixel = np.arange(height * width).reshape(height, width)
        rows.append(np.diag(np.sqrt(prior.damping[..., i].ravel())))
        for ties, first, second in (
            (prior.right[:, :-1], pixel[:, :-1], pixel[:, 1:]),
            (prior.down[:-1], pixel[:-1], pixel[1:]),
        ):
            D = np.zeros((first.size, pixel.size))
            D[np.arange(first.size), first.ravel()], D[np.arange(first.size), second.ravel()] = 1, -1
            rows.append(np.sqrt(ties[..., i].ravel())[:, None] * D)
    A = np.concatenate(rows)
    return A, np.concatenate([target, np.zeros(len(A) - target.size)])


def best(objective: Objective, b: FloatArray, i: int) -> float:
    """Minimum of the objective of channel i over 0 ≤ p ≤ 1."""
    return float(lsq_linear(*augmented(objective, b, i), (0, 1), method="bvls", tol=1e-12).cost)


def value(objective: Objective, p: FloatArray, b: FloatArray, i: int) -> float:
    """Objective of channel i at p, (projector pixels, 3)."""
    A, a = augmented(objective, b, i)
    return float(np.sum((A @ p[:, i] - a) ** 2) / 2)
