"""Response tables that rise strictly from 0 to 1, in the file format that --response of every command reads."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import tomli_w

from counterlight.arrays import FloatArray
from counterlight.response import Response
from counterlight.writing.replacing import replacing_file

SUFFIXES = (".toml",)  # suffix by which --response recognises a file
NODES = 256  # rows of a table; codes of deeper cameras are interpolated
STRICT = 1e-6  # share of full scale; least rise over the whole table


def table_response(columns: FloatArray) -> Response:
    """Make a table of curves that rise from 0 to 1 but may be flat in places; `columns` is (NODES, 1 or 3)."""
    ramp = np.linspace(0, 1, len(columns))[:, None]
    table = columns + STRICT * (ramp - columns)
    return Response("table", table=tuple(tuple(float(v) for v in row) for row in table))


def write_response(path: Path, response: Response, notes: Mapping[str, object] | None = None) -> None:
    """Write `response = …`, preceded by the notes on the device."""
    with replacing_file(path) as temporary:
        temporary.write_text(tomli_w.dumps({**(notes or {}), "response": response.to_toml()}), encoding="utf-8")
