"""Recover the camera's response with a chosen method, and check that the bracket is suitable."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.hdr import debevec, robertson
from counterlight.tools.hdr.camera_response import NODES, rising_response
from counterlight.tools.hdr.estimators import MARGIN, weight_table

METHODS = ("debevec", "robertson")
LEAST_NODES = 32  # different codes required among pixels with two good exposures
NAME_IT = "name the response instead (--response linear, srgb or FILE)"


def recover_response(samples: FloatArray, times_s: FloatArray, method: str) -> Response:
    """Recover the camera's response from a bracket.

    samples : (pictures, pixels, channels). Code values, 0 to 1.
    times_s : (pictures,). Seconds.
    method : one of METHODS.

    Raises InputError if hardly any pixel is well exposed in two pictures.
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
        return robertson.recover_response(codes, times_s, weights)
    return np.exp(debevec.recover_log_response(codes, np.log(times_s), weights)), weights


def _check_shown(codes: FloatArray) -> None:
    shown = len(np.unique(np.rint(codes * (NODES - 1))))
    if shown < LEAST_NODES:
        raise InputError(
            f"the bracket shows {shown} code values in pixels that two pictures expose well, expected at least "
            f"{LEAST_NODES} to recover the response; take smaller steps of time, avoid black and saturated pictures, "
            f"or {NAME_IT}"
        )
