"""Mixes the channels of a transport, T'_k = Σ_j X_kj T_j, for another camera or for a colour tier."""

from dataclasses import replace

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import Transport

FAINT = 1e-9  # share of a row's own light; less cannot be scaled reliably


def mixed_channels(transport: Transport, mixing: FloatArray) -> Transport:
    """Return T'_k = Σ_j X_kj T_j, without negative entries; each row of near light keeps its exact sum, or 0.

    mixing : X, (3, 3), or (camera pixels, 3, 3) for one matrix per camera pixel.

    Negative entries come from differing footprints of primaries, or from noise. They are dropped, and the row is scaled
    to its sum (measured rooms: up to 1 % of the entries, 0.007 % of the light). Far light is U M D, and a sum of three
    such products has no such form. Channel k keeps its own factors, scaled per camera pixel to the floodlight Σ_j X_kj
    U_j M_j D_j 1 (docs/colour.md states the cost).
    """
    near, far, blurred = transport.near, transport.far, transport.blurred
    mixed = replace(transport, near=_mixed_rows(near, mixing))
    if blurred is not None:  # one P for all channels: B is mixed as S is
        mixed = replace(mixed, blurred=replace(blurred, scatter=_mixed_rows(blurred.scatter, mixing)))
    if far is None:
        return mixed
    floodlight = far.apply(np.ones((transport.shape[1], 3)))
    scatter = far.scatter.scaled(_ratio(_mixed_light(mixing, floodlight), floodlight))
    return replace(mixed, far=replace(far, scatter=scatter))


def _mixed_rows(light: SparseRows, mixing: FloatArray) -> SparseRows:
    """Mix entry by entry, drop negative entries, and scale each row to its sum."""
    rows = light.rows if mixing.ndim == 3 else np.zeros(light.indices.size, np.int8)
    each = mixing.reshape(-1, 3, 3)
    weights = np.stack(
        [sum(each[rows, k, j] * light.weights[:, j] for j in range(3)) for k in range(3)], axis=1
    )  # channel by channel: nine numbers per entry would be the room's largest array
    found = replace(light, weights=np.maximum(weights, 0).astype(light.weights.dtype))
    return found.scaled(_ratio(_mixed_light(mixing, light.sums()), found.sums()))


def _mixed_light(mixing: FloatArray, light: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...kj,...j->...k", mixing, light))


def _ratio(wanted: FloatArray, found: FloatArray) -> FloatArray:
    """Return max(wanted, 0) / found; 0 if there is too little to scale."""
    enough = found > FAINT * np.max(found, initial=0.0)
    return np.divide(np.maximum(wanted, 0), found, out=np.zeros_like(found), where=enough)
