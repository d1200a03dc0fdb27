"""Primaries that projectors of different colours share, and each projector's rendering of them (thesis 4.1.2, eq. 4.5).

On a white screen, projector i shows N_i diag(w_i) p for its drive p. N_i holds the chromaticities of its primaries,
with columns of sum 1, and w_i their brightness. Each projector would need nine matrices. With

    p = D_i q,    D_i = diag(w_i)⁻¹ N_i⁻¹ G S_i,    S_i = diag(G⁻¹ N_i w_i)

all projectors show G S_i q: the same three colours, and q = 1 is each projector's own white. Each column of G is the
colour nearest to the mean of the projectors' primaries that all can show, N_i⁻¹ G ≥ 0.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from counterlight.arrays import BoolArray, FloatArray
from counterlight.errors import InputError
from counterlight.maps.mixing import invertible
from counterlight.pipeline.content import BRIGHT_PERCENTILE
from counterlight.tools.colour.neutral import DARK, neutral_mixing

ALIKE = 0.003  # share of a primary's light in the wrong channel; 50 dB, as in tiers.py
BORDER = 1e-6  # allowed error at a gamut's border by rounding, as a share of D
FEWEST = 16  # camera pixels needed to compare two whites


def colour_matrices(
    primaries: Sequence[NDArray[np.floating]], masks: Sequence[BoolArray], names: Sequence[str]
) -> tuple[FloatArray | None, ...]:
    """Return D of each projector, (3, 3) ≥ 0 with rows of sum 1; None if the shared primaries are its own.

    Returns None for all if some projector's primaries cannot be distinguished: colour is then ignored (tiers.py).

    primaries : (3, camera height, camera width, 3) each. Light above ambient.
    masks : where each projector lights the scene.

    Raises InputError, with the projectors' names, for primaries that have no white in common.
    """
    neutral = [neutral_mixing(light, mask) for light, mask in zip(primaries, masks, strict=True)]
    if not all(map(invertible, neutral)):
        return (None,) * len(names)
    chromaticities = [mixing / mixing.sum(axis=0) for mixing in neutral]
    G = _shared(chromaticities)
    found = [_matrix(N, white, G) for N, white in zip(chromaticities, _whites(primaries, masks), strict=True)]
    for name, D in zip(names, found, strict=True):
        if D is None:
            raise InputError(
                f"{name}: the colours of {', '.join(names)} have no white in common; set the projectors' colour modes "
                "alike and acquire them again"
            )
    return tuple(None if D is None or np.abs(D - np.eye(3)).max() <= ALIKE else D for D in found)


def _matrix(N: FloatArray, white: FloatArray, G: FloatArray) -> FloatArray | None:
    """Return D for chromaticities N, a white (3,) and shared primaries G; None if a share would be negative."""
    if not invertible(G):
        return None
    shares, w = np.linalg.solve(G, white), np.linalg.solve(N, white)
    if min(shares.min(), w.min()) <= 0:
        return None
    D = np.linalg.solve(N * w, G * shares)
    if D.min() < -BORDER:
        return None
    D = np.maximum(D, 0)
    return np.asarray(D / D.sum(axis=1, keepdims=True))


def _shared(chromaticities: Sequence[FloatArray]) -> FloatArray:
    """Return G: each primary's mean, or the nearest colour within every gamut, columns of sum 1 (0 if there is none).

    min ‖x − x₀‖ for A x ≥ 0 by non-negative least squares (Lawson and Hanson 1974, chapter 23).
    """
    mean = np.mean(chromaticities, axis=0)
    A = np.concatenate([np.linalg.inv(N) for N in chromaticities])
    columns = []
    for wanted in mean.T:
        E = np.vstack([A.T, -A @ wanted])
        u, _ = nnls(E, np.array([0.0, 0.0, 0.0, 1.0]))
        residual = E @ u - [0.0, 0.0, 0.0, 1.0]
        nearest = wanted - residual[:3] / residual[3]
        columns.append(nearest / max(nearest.sum(), np.finfo(float).tiny))
    return np.stack(columns, axis=1)


def _whites(primaries: Sequence[NDArray[np.floating]], masks: Sequence[BoolArray]) -> list[FloatArray]:
    """Return each projector's white on a neutral surface as the camera sees it, (3,), relative to the first white.

    Where two projectors light the same place, paint cancels; without such a place, the difference does not matter.
    """
    floodlights = [np.asarray(light, np.float64).sum(axis=0) for light in primaries]
    lit = [_well_lit(light, mask) for light, mask in zip(floodlights, masks, strict=True)]
    whites: dict[int, FloatArray] = {0: np.ones(3)}
    while len(whites) < len(floodlights):
        pairs = [(known, new) for known in whites for new in range(len(floodlights)) if new not in whites]
        known, new = max(pairs, key=lambda pair: np.count_nonzero(lit[pair[0]] & lit[pair[1]]))
        both = lit[known] & lit[new]
        whites[new] = np.ones(3)
        if np.count_nonzero(both) >= FEWEST:
            tint = np.median(np.log(floodlights[new][both] / floodlights[known][both]), axis=0)
            whites[new] = whites[known] * np.exp(tint - tint.mean())
    return [whites[number] for number in range(len(floodlights))]


def _well_lit(floodlight: FloatArray, mask: BoolArray) -> BoolArray:
    inside = floodlight[mask]
    bright = np.percentile(inside, BRIGHT_PERCENTILE, axis=0) if len(inside) else np.ones(3)
    return np.asarray(mask & (floodlight > DARK * bright).all(axis=2) & (bright > 0).all())
