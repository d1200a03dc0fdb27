"""The camera's response as a table: code value → exposure E·Δt, relative to the exposure of the highest code.

Recovery determines f⁻¹ only up to a factor per channel (thesis eq. 3.3), and not at all where the weight is 0. The
table is made to rise strictly from 0 to 1, as counterlight.response.Response requires, so that cameras and projectors
share one kind of file.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import tomli_w
from scipy.optimize import isotonic_regression

from counterlight.arrays import FloatArray
from counterlight.errors import InputError
from counterlight.response import Response
from counterlight.writing.replacing import replacing_file

SUFFIXES = (".toml",)  # suffix by which --response recognises a file
NODES = 256  # rows of a table; codes of deeper cameras are interpolated
STRICT = 1e-6  # least rise over the whole table, as a share of full scale


def table_response(columns: FloatArray) -> Response:
    """Make a table of curves that rise from 0 to 1 but may be flat in places; `columns` is (NODES, 1 or 3)."""
    ramp = np.linspace(0, 1, len(columns))[:, None]
    table = columns + STRICT * (ramp - columns)
    return Response("table", table=tuple(tuple(float(v) for v in row) for row in table))


def write_response(path: Path, response: Response, notes: Mapping[str, object] | None = None) -> None:
    """Write `response = …`, preceded by the notes on the device."""
    with replacing_file(path) as temporary:
        temporary.write_text(tomli_w.dumps({**(notes or {}), "response": response.to_toml()}), encoding="utf-8")


TOP_NODES = 16  # the curve is continued to the top by the power law of its highest known nodes


def exposure_table(response: Response, levels: int, channels: int) -> FloatArray:
    """Returns f⁻¹ of each code value, (levels, channels), 0 to 1; InputError for a colour response of a grey camera."""
    columns = len(response.table[0]) if response.kind == "table" else 1
    if columns > channels:
        raise InputError(f"response: a table of {columns} columns, the pictures are grey; give it one column")
    codes = np.linspace(0, 1, levels)[:, None].repeat(3, axis=1)
    return response.to_linear(codes)[:, :channels]


def rising_response(exposure: FloatArray, weights: FloatArray) -> Response:
    """Make a table from a recovered f⁻¹: the nearest rising curve, continued to the ends and divided by its top.

    exposure : (nodes, channels). Any scale.
    weights : (nodes, channels). 0 where f⁻¹ is unknown.
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
