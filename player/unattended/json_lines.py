"""One JSON value a line, as the control socket and the heartbeat write them."""

import json
import math
from collections.abc import Mapping, Sequence


def encode(value: object) -> bytes:
    """A line of JSON in ASCII; numbers that JSON does not know (NaN, infinity) become null."""
    return json.dumps(finite(value), allow_nan=False).encode("ascii") + b"\n"


def finite(value: object) -> object:
    """The same with null for numbers that JSON does not know, tuples and mappings as JSON has them."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [finite(item) for item in value]
    return value
