"""JSON lines: one JSON value per line, for the control socket and the heartbeat."""

import json
import math
from collections.abc import Mapping, Sequence


def encode(value: object) -> bytes:
    """Encode a value as a line of JSON in ASCII. NaN and infinity become null."""
    return json.dumps(finite(value), allow_nan=False).encode("ascii") + b"\n"


def finite(value: object) -> object:
    """Replace NaN and infinity by None, and convert tuples and mappings to JSON's types."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [finite(item) for item in value]
    return value
