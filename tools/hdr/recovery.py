"""Recover the camera's response from a bracket, with a chosen method, and check that the bracket is suitable.

debevec: linear least squares. P. E. Debevec and J. Malik, Recovering High Dynamic Range Radiance Maps from Photographs,
SIGGRAPH 1997.
robertson: alternates between estimates of light and response. M. A. Robertson, S. Borman and R. L. Stevenson, Dynamic
Range Improvement through Multiple Exposures, ICIP 1999, and Estimation-theoretic approach to dynamic range enhancement
using multiple exposures, J. Electronic Imaging 12(2), 2003.
"""

import numpy as np
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.hdr.camera_response import NODES, rising_response
from counterlight.tools.hdr.estimators import MARGIN, weight_table

METHODS = ("debevec", "robertson")
LEAST_NODES = 32  # different codes required among pixels with two good exposures
NAME_IT = "name the response instead (--response linear, srgb or FILE)"
MAX_ROUNDS = 300
SETTLED = 1e-4  # mean change of f⁻¹ per round, relative to the middle of the curve
SMOOTHNESS = 20.0  # λ for 1000 values (100 pixels in 10 pictures); with λ = 10, curves of real JPEGs follow their noise
USUAL_VALUES = 1000


def recover_response(samples: FloatArray, times_s: FloatArray, method: str) -> Response:
    """Recover the camera's response from a bracket.

    samples : (pictures, pixels, channels). Code values, 0 to 1.
    times_s : (pictures,). Seconds.
    method : one of METHODS.

    Raises InputError if too few pixels are well exposed in two pictures.
    """
    columns = [_recover_channel(codes, times_s, method) for codes in np.moveaxis(samples, -1, 0)]
    return rising_response(*(np.stack(values, axis=-1) for values in zip(*columns, strict=True)))


def _recover_channel(codes: FloatArray, times_s: FloatArray, method: str) -> tuple[FloatArray, FloatArray]:
    """Returns f⁻¹ at each node, in any scale, and its weight; the weight is 0 at both ends of the range."""
    inside = (codes > MARGIN) & (codes < 1 - MARGIN)
    codes, inside = codes[:, inside.sum(axis=0) >= 2], inside[:, inside.sum(axis=0) >= 2]
    _check_shown(codes[inside])
    weights = weight_table("hat" if method == "debevec" else "gaussian", NODES)
    nodes = np.linspace(0, 1, NODES)
    weights = np.where((nodes > MARGIN) & (nodes < 1 - MARGIN), weights, 0)
    if method == "robertson":
        return robertson_response(codes, times_s, weights)
    return np.exp(debevec_log_response(codes, np.log(times_s), weights)), weights


def _check_shown(codes: FloatArray) -> None:
    shown = len(np.unique(np.rint(codes * (NODES - 1))))
    if shown < LEAST_NODES:
        raise InputError(
            f"the bracket shows {shown} code values in pixels that two pictures expose well, expected at least "
            f"{LEAST_NODES} to recover the response; take smaller steps of time, avoid black and saturated pictures, "
            f"or {NAME_IT}"
        )


def robertson_response(
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


def debevec_log_response(
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
