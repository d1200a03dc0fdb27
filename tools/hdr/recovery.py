"""Which method recovers the camera's response, and what a bracket must show for it."""

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.hdr import debevec, robertson
from counterlight.tools.hdr.camera_response import rising_response
from counterlight.tools.hdr.estimators import MARGIN
from counterlight.tools.hdr.response_table import NODES
from counterlight.tools.hdr.weights import weight_table

METHODS = ("debevec", "robertson")
LEAST_NODES = 32  # different codes that pixels with two good exposures must show
NAME_IT = "name the response instead (--response linear, srgb or FILE)"


def recover_response(samples: FloatArray, times_s: FloatArray, method: str) -> Response:
    """The camera's response from a bracket.

    samples : (pictures, pixels, channels), codes 0..1.  times_s : (pictures,).  method : one of METHODS.
    Raises InputError if hardly any pixel is well exposed in two pictures.
    """
    columns = [_recover_channel(codes, times_s, method) for codes in np.moveaxis(samples, -1, 0)]
    return rising_response(*(np.stack(values, axis=-1) for values in zip(*columns, strict=True)))


def _recover_channel(codes: FloatArray, times_s: FloatArray, method: str) -> tuple[FloatArray, FloatArray]:
    """f⁻¹ at each node, any scale, and how far to trust it, 0 where nothing is known: at both ends of the range."""
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
