"""One JSON value a line, as the control socket and the heartbeat write them."""

import json
import math
from collections.abc import Mapping, Sequence


def encode(value: object) -> bytes:
    """A line of JSON in ASCII; numbers that JSON does not know (NaN, infinity) become null."""
    return json.dumps(_finite(value), allow_nan=False).encode("ascii") + b"\n"


def _finite(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_finite(item) for item in value]
    return value
