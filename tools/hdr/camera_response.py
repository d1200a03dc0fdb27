"""The camera's response as a table: code value -> exposure E·Δt relative to what the highest code stands for.

Recovery knows f⁻¹ only up to a factor a channel (thesis eq. 3.3), and knows nothing of codes whose weight is 0. The
table is made to rise strictly from 0 to 1, as counterlight.response.Response wants it, so that one kind of file serves
cameras and projectors.
"""

import numpy as np
from scipy.optimize import isotonic_regression

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.tools.hdr.response_table import table_response

TOP_NODES = 16  # the top of the curve continues the power law that these follow


def exposure_table(response: Response, levels: int, channels: int) -> FloatArray:
    """f⁻¹ of every code value: (levels, channels), 0..1. InputError for a coloured response of a grey camera."""
    columns = len(response.table[0]) if response.kind == "table" else 1
    if columns > channels:
        raise InputError(f"response: a table of {columns} columns, the pictures are grey; give it one column")
    codes = np.linspace(0, 1, levels)[:, None].repeat(3, axis=1)
    return response.to_linear(codes)[:, :channels]


def rising_response(exposure: FloatArray, weights: FloatArray) -> Response:
    """A recovered f⁻¹ made into a table: the nearest rising curve, continued to the ends, divided by its top.

    exposure : (nodes, channels), any scale.  weights : (nodes, channels), 0 where f⁻¹ says nothing.
    """
    columns = [_rising_column(f, w) for f, w in zip(exposure.T, weights.T, strict=True)]
    return table_response(np.stack(columns, axis=1))


def _rising_column(exposure: FloatArray, weights: FloatArray) -> FloatArray:
    codes = np.linspace(0, 1, len(exposure))
    known = np.flatnonzero(weights > 0)
    rising = np.maximum(isotonic_regression(exposure[known], weights=weights[known]).x, 0)
    top = known[-TOP_NODES:]
    slope = np.polyfit(np.log(codes[top]), np.log(rising[-TOP_NODES:]), 1)[0]
    highest = rising[-1] * codes[known[-1]] ** -max(slope, 0.0)
    return np.asarray(np.interp(codes, np.r_[0, codes[known], 1], np.r_[0, rising, highest]) / highest)
