"""Array types for annotations, and short printing of objects that hold arrays. Shapes are in the docstrings."""

from dataclasses import fields, is_dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from counterlight.errors import LONGEST, one_line

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]


def brief(self: Any) -> str:
    """Return one line for a dataclass of arrays, with their types and shapes. For use as `__repr__`."""
    values = ((field.name, getattr(self, field.name)) for field in fields(self) if field.repr)
    return f"{type(self).__name__}({', '.join(f'{name}={_brief(value)}' for name, value in values)})"


def _brief(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"<{value.dtype} {value.shape}>"
    return f"<{type(value).__name__}>" if is_dataclass(value) else one_line(repr(value), LONGEST)
