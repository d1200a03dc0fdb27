"""Recover the camera's response by alternating between estimates of light and response.

M. A. Robertson, S. Borman and R. L. Stevenson, Dynamic Range Improvement through Multiple Exposures, ICIP 1999, and
Estimation-theoretic approach to dynamic range enhancement using multiple exposures, J. Electronic Imaging 12(2), 2003.
"""

import numpy as np

from counterlight.arrays import FloatArray

MAX_ROUNDS = 300
SETTLED = 1e-4  # mean change of f⁻¹ per round, relative to the middle of the curve


def recover_response(
    codes: FloatArray,
    times: FloatArray,
    weights: FloatArray,
    *,
    max_rounds: int = MAX_ROUNDS,
    settled: float = SETTLED,
) -> tuple[FloatArray, FloatArray]:
    """Returns f⁻¹ at the nodes of a table, and the number of values behind each node, for one channel.

    Alternates between E_i by eq. 3.6 of the thesis with the present f⁻¹, and f⁻¹(z) = mean of t_j E_i over all values
    of code z (Robertson et al. 2003, eq. 10), scaled to 1 in the middle. Starts from a straight line.

    codes : (pictures, pixels). 0 to 1 of the range, counted at the nearest node.
    times : (pictures,). Seconds.
    weights : (nodes,). 0 at the ends, where codes do not determine the light.

    Returns (nodes,) and (nodes,); nodes without values are interpolated and count 0.
    """
    nodes = len(weights)
    z = np.rint(codes * (nodes - 1)).astype(np.int64)
    t = (times / np.exp(np.log(times).mean()))[:, None]
    w = weights[z]
    mass = (w * t**2).sum(axis=0)
    weighed = (w > 0) & (mass > 0)
    counts = np.bincount(z[weighed], minlength=nodes).astype(np.float64)
    seen = counts > 0
    grid, middle = np.arange(nodes), nodes // 2
    exposure = grid / middle
    for _ in range(max_rounds):
        E = np.divide((w * t * exposure[z]).sum(axis=0), mass, out=np.zeros_like(mass), where=mass > 0)
        total = np.bincount(z[weighed], (t * E)[weighed], nodes)
        updated = np.interp(grid, grid[seen], total[seen] / counts[seen])
        updated /= updated[middle]
        change = float(np.abs(updated - exposure)[seen].mean())
        exposure = updated
        if change < settled:
            break
    return exposure, counts
