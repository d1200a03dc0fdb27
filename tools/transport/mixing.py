"""Channels of a transport mixed, T'_k = Σ_j X_kj T_j: another camera's, or what tiers of colour are made of."""

from dataclasses import replace

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.transport.transport import Transport

FAINT = 1e-9  # of a row's own light: less cannot be scaled to anything


def mixed_channels(transport: Transport, mixing: FloatArray) -> Transport:
    """T'_k = Σ_j X_kj T_j, no entry below 0 and every row of near light of the sum that belongs to it, or of 0.

    mixing : X, (3, 3), or one for each camera pixel, (camera pixels, 3, 3).
    An entry below 0 is what primaries' footprints, or noise, differ by: it is left out, and the row scaled to its sum
    (measured rooms: up to 1 % of the entries, 0.007 % of the light).
    Far light is U M D, no sum of three such products; it stays that of channel k, scaled camera pixel by camera pixel
    to the floodlight Σ_j X_kj U_j M_j D_j 1 (docs/colour.md says what that costs).
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
    """Entry by entry, without those below 0, each row scaled to its sum."""
    rows = light.rows if mixing.ndim == 3 else np.zeros(light.indices.size, np.int8)
    each = mixing.reshape(-1, 3, 3)
    weights = np.stack(
        [sum(each[rows, k, j] * light.weights[:, j] for j in range(3)) for k in range(3)], axis=1
    )  # channel by channel: nine numbers an entry would be the room's largest array
    found = replace(light, weights=np.maximum(weights, 0).astype(light.weights.dtype))
    return found.scaled(_ratio(_mixed_light(mixing, light.sums()), found.sums()))


def _mixed_light(mixing: FloatArray, light: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...kj,...j->...k", mixing, light))


def _ratio(wanted: FloatArray, found: FloatArray) -> FloatArray:
    """max(wanted, 0) / found; 0 where there is nothing to scale."""
    enough = found > FAINT * np.max(found, initial=0.0)
    return np.divide(np.maximum(wanted, 0), found, out=np.zeros_like(found), where=enough)
