"""Removes the far light from a target before the near light is inverted.

With T = S + U M D and S⁺ the inverse of the near light, compensation seeks p = S⁺ (b − U M D p). With y = M D p,

    y = M D S⁺ (b − U y)   ⟹   y = (I + M D S⁺ U)⁻¹ M · D S⁺ b = M' · D' b,      p = S⁺ (b − U y),

so the far light of the *compensated* picture follows from the target: gather it onto the cells with D' = D S⁺, mix with
M', and subtract what U scatters (the Woodbury identity, if S⁺ = S⁻¹). All factors are small.
"""

import numpy as np
from scipy import sparse

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.maps.row_map import SparseRows
from counterlight.tools.jobs import side_by_side
from counterlight.tools.transport.transport import Csr, Dense, FarLight, channels, stacked

LARGEST = 1e30  # largest entry of a factor; products with light, summed, then stay within float32
ADVICE = "give more --regularize, or look for what is extreme in far_light.npz"
# share of a row's largest entry: gathers average hundreds of pixels, and smaller entries only cost time
RELATIVE_THRESHOLD = 1e-4


def undo_far_light(far: FarLight, T_pinv: SparseRows) -> FarLight:
    """Return D', M' and U: U M' D' b is the far light that the camera sees when b is compensated.

    T_pinv : S⁺, (projector pixels, camera pixels).

    Raises InputError if the equation for y has no solution within float32.
    """
    factors = channels(far.gather), far.mix.matrices, channels(far.scatter), channels(T_pinv)
    gather, mix = zip(*side_by_side(_undone, *factors), strict=True)
    return FarLight(stacked(gather), Dense(np.stack(mix)), far.scatter)


def _undone(D: Csr, M: FloatArray, U: Csr, S_pinv: Csr) -> tuple[Csr, FloatArray]:
    """Return D' and M' of a channel."""
    D_inverse = _without_tails(sparse.csr_array(D @ S_pinv.astype(np.float64)))
    mix = _solved(np.eye(M.shape[0]) + M @ (D_inverse @ U).toarray(), M)
    largest = max(np.abs(mix).max(), np.abs(D_inverse.data).max(initial=0.0))
    if not largest <= LARGEST:
        raise InputError(f"the far light of a compensated picture is {largest:g} times it; {ADVICE}")
    return D_inverse, mix


def _solved(loop: FloatArray, M: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.solve(loop, M))
    except np.linalg.LinAlgError:
        raise InputError(
            f"no far light belongs to a compensated picture (I + M D S⁺ U is singular); {ADVICE}"
        ) from None


def _without_tails(matrix: Csr) -> Csr:
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    largest = np.zeros(matrix.shape[0])
    np.maximum.at(largest, rows, np.abs(matrix.data))
    matrix.data[np.abs(matrix.data) < RELATIVE_THRESHOLD * largest[rows]] = 0
    matrix.eliminate_zeros()
    return matrix
