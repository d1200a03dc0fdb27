"""Response tables: rising strictly from 0 to 1, in the file that --response of every command reads."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import tomli_w

from counterlight.arrays import FloatArray
from counterlight.response import Response
from counterlight.writing.replacing import replacing_file

SUFFIXES = (".toml",)  # what --response takes for a file
NODES = 256  # rows of a table; deeper cameras are interpolated between them
STRICT = 1e-6  # of full scale: the least rise over the whole table


def table_response(columns: FloatArray) -> Response:
    """A table of curves that rise from 0 to 1 but may be level in places.

    columns : (NODES, 1 or 3).
    """
    ramp = np.linspace(0, 1, len(columns))[:, None]
    table = columns + STRICT * (ramp - columns)
    return Response("table", table=tuple(tuple(float(v) for v in row) for row in table))


def write_response(path: Path, response: Response, notes: Mapping[str, object] | None = None) -> None:
    """Write `response = …` and, above it, what else is known of the device."""
    with replacing_file(path) as temporary:
        temporary.write_text(tomli_w.dumps({**(notes or {}), "response": response.to_toml()}), encoding="utf-8")
