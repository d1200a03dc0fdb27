"""Arrays of equal length that are cut together."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import IntArray


class Batch:
    """A dataclass of arrays with one row per ray, point or beam; text fields hold for the whole batch."""

    def at(self, index: NDArray[np.bool_] | IntArray | slice) -> Self:
        """Returns some of the rows."""
        columns = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        return type(self)(**{k: v if isinstance(v, str) else v[index] for k, v in columns.items()})


B = TypeVar("B", bound=Batch)


def joined(parts: Sequence[B]) -> B:
    """Returns one batch with the rows of all batches; text fields are those of the first batch."""
    names = [field.name for field in fields(parts[0])]  # type: ignore[arg-type]
    columns = {name: [getattr(part, name) for part in parts] for name in names}
    return type(parts[0])(**{k: v[0] if isinstance(v[0], str) else np.concatenate(v) for k, v in columns.items()})
