"""The unweighted optimum over lit pixels, by scipy and from T alone: the judge of every "dB below the best".

Camera pixels are lit if their floodlight T·1 exceeds 1 % of its 99th percentile. Pixels are inside the border if
they lie at least four pixels within the lit area. Every array holds one channel.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage, sparse
from scipy.optimize import minimize

BORDER = 4
CERTAIN_DB = 0.02
ROUNDS, STEPS = 40, 250


@dataclass(frozen=True)
class Judge:
    """Judges drives of one room.

    T : (camera pixels, projector pixels).
    camera : (height, width).
    """

    T: sparse.csr_array
    camera: tuple[int, int]

    @cached_property
    def floodlight(self) -> np.ndarray:
        return np.asarray(self.T.sum(axis=1)).ravel()

    @cached_property
    def lit(self) -> np.ndarray:
        return (self.floodlight > 0.01 * np.percentile(self.floodlight, 99)).reshape(self.camera)

    @cached_property
    def inside(self) -> np.ndarray:
        """Return the pixels inside the border; none if the lit area is narrower than nine pixels everywhere."""
        return ndimage.binary_erosion(self.lit, np.ones((3, 3)), iterations=BORDER, border_value=0)

    def psnr(self, p: np.ndarray, b: np.ndarray, white: float) -> tuple[float, float]:
        """Return decibels against white, over all lit pixels and inside the border.

        p : (projector pixels,). Drive.
        b : (camera pixels,). Target.
        """
        errors = ((self.T @ p - b) ** 2).reshape(self.camera)
        over_all, within = (float(10 * np.log10(white**2 / errors[part].mean())) for part in (self.lit, self.inside))
        return over_all, within

    def optimum(self, b: np.ndarray) -> np.ndarray:
        """Return the drive that minimises Σ (T p − b)² over the lit pixels, 0 ≤ p ≤ 1, to CERTAIN_DB.

        L-BFGS-B runs until the gap Σ max(g p, g (p − 1)) certifies it.
        """
        A = sparse.csr_array(sparse.diags_array(self.lit.ravel().astype(float)) @ self.T.astype(np.float64))
        At, wanted = sparse.csr_array(A.T), np.where(self.lit.ravel(), b, 0)
        scale = max(float(wanted @ wanted), 1e-300)

        def half_squares(p: np.ndarray) -> tuple[float, np.ndarray]:
            residual = A @ p - wanted
            return float(residual @ residual) / 2 / scale, At @ residual / scale

        p, bounds = np.full(A.shape[1], 0.5), [(0, 1)] * A.shape[1]
        limits = {"maxiter": STEPS, "maxfun": 10 * STEPS, "maxcor": 30, "ftol": 0, "gtol": 0}
        for _ in range(ROUNDS):
            p = minimize(half_squares, p, jac=True, method="L-BFGS-B", bounds=bounds, options=limits).x
            error, g = half_squares(p)
            if np.maximum(g * p, g * (p - 1)).sum() <= (10 ** (CERTAIN_DB / 10) - 1) * error + 1e-12:
                return p
        raise AssertionError("scipy did not come within its tolerance")

    def direct(self, b: np.ndarray) -> np.ndarray:
        """Return direct mapping: a projector pixel takes b / floodlight of the camera pixel that it lights most."""
        columns = self.T.tocsc()
        most, lights = np.asarray(columns.argmax(axis=0)).ravel(), np.asarray(columns.sum(axis=0)).ravel() > 0
        asked = np.divide(b[most], self.floodlight[most], out=np.zeros(most.size), where=lights)
        return np.clip(asked, 0, 1)
