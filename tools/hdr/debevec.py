"""Recover the camera's response by linear least squares.

P. E. Debevec and J. Malik, Recovering High Dynamic Range Radiance Maps from Photographs, SIGGRAPH 1997.
"""

import numpy as np
from scipy import sparse

from counterlight.arrays import FloatArray

SMOOTHNESS = 20.0  # λ for 1000 values: 100 pixels in 10 pictures; on real JPEGs, 10 follows their noise
USUAL_VALUES = 1000


def recover_log_response(
    codes: FloatArray, log_times: FloatArray, weights: FloatArray, smoothness: float | None = None
) -> FloatArray:
    """Returns g = ln f⁻¹ at the nodes of a table, for one channel: Debevec and Malik 1997, eq. 3.

    Minimises Σ [w(z) (g(z) − ln E_i − ln t_j)]² + λ² Σ [w(z) (g(z−1) − 2 g(z) + g(z+1))]² with g = 0 in the middle.
    Each ln E_i is a weighted mean of the other terms and is eliminated. The system therefore has one unknown per node,
    whatever the number of pixels.

    codes : (pictures, pixels). 0 to 1 of the range; g is linear between nodes.
    log_times : (pictures,). ln t_j.
    weights : (nodes,). w.
    smoothness : λ; None scales λ = 20 with the root of the number of values.

    Returns (nodes,).
    """
    nodes = len(weights)
    if smoothness is None:
        smoothness = SMOOTHNESS * float(np.sqrt(max(1.0, codes.size / USUAL_VALUES)))
    position = codes.ravel() * (nodes - 1)
    w = np.interp(position, np.arange(nodes), weights)
    G = sparse.diags_array(w) @ _interpolation(position, nodes)
    pixel = np.tile(np.arange(codes.shape[1]), len(codes))
    E = sparse.csr_array((w, (np.arange(w.size), pixel)), shape=(w.size, codes.shape[1]))
    b = w * np.repeat(log_times, codes.shape[1])
    mass = np.bincount(pixel, w**2, codes.shape[1])
    share = sparse.diags_array(np.divide(1.0, mass, out=np.zeros_like(mass), where=mass > 0))
    GtE = G.T @ E
    normal = (G.T @ G - GtE @ share @ GtE.T).toarray()
    right = G.T @ b - GtE @ (share @ (E.T @ b))
    curvature = smoothness * weights[1:-1, None] * np.diff(np.eye(nodes), 2, axis=0)
    normal += curvature.T @ curvature
    middle = nodes // 2
    normal[middle, middle] += normal.diagonal().mean()  # g = 0 here; fixes the common factor of E and f⁻¹
    return np.asarray(np.linalg.lstsq(normal, right, rcond=None)[0])


def _interpolation(position: FloatArray, nodes: int) -> sparse.csr_array:
    """Returns the matrix that interpolates a table linearly at some positions."""
    low = np.minimum(position.astype(np.int64), nodes - 2)
    high_share = position - low
    row = np.arange(position.size)
    entries = np.concatenate([1 - high_share, high_share])
    columns = np.concatenate([low, low + 1])
    return sparse.csr_array((entries, (np.concatenate([row, row]), columns)), shape=(position.size, nodes))
