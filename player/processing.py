"""A projector's colour processing: the light of a primary depends on the codes of all primaries."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import brief
from counterlight.errors import InputError

LEVELS = 5  # codes per primary at which B is known.
CELLS = 16  # light levels per primary of the table for the player
LIMITS = 0.1, 10.0  # smallest and largest B
ROUNDS = 40  # rounds of the inverse; each round at least halves the error

Codes = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class Processing:
    """B of a projector that shows p_i = r_i(c_i) B_i(c) for codes c, with the curves r of each primary alone.

    B is interpolated between LEVELS³ equally spaced codes, and is 1 at white, where T is measured. For light p the
    player sends the codes of the light p_i / B_i(c), so that light adds up as T requires.

    Raises InputError for values that are not within LIMITS.

    samples : (LEVELS³, 3). B of red, green and blue; blue's code changes fastest, then green's.
    """

    samples: tuple[tuple[float, ...], ...]

    __repr__ = brief

    def __post_init__(self) -> None:
        if len(self.samples) != LEVELS**3 or {len(row) for row in self.samples} != {3}:
            raise InputError(f"processing: expected {LEVELS**3} rows of three numbers")
        table, (least, most) = np.array(self.samples, np.float64), LIMITS
        if not np.all((table >= least) & (table <= most)):
            raise InputError(f"processing: expected factors from {least:g} to {most:g}")

    def factor(self, codes: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return B of codes 0..1, (…, 3)."""
        place = np.clip(np.asarray(codes, np.float64), 0, 1) * (LEVELS - 1)
        low = np.minimum(place.astype(np.int64), LEVELS - 2)
        share, found = place - low, np.zeros(place.shape)
        for corner in product((0, 1), repeat=3):
            weight = np.prod(np.where(np.array(corner) == 1, share, 1 - share), axis=-1)
            red, green, blue = np.moveaxis(low + corner, -1, 0)
            found += weight[..., None] * self._table[red, green, blue]
        return found

    def table(self, codes_of: Codes) -> NDArray[np.float32]:
        """Return 1 / √B at equal steps of √p: (CELLS, CELLS, CELLS, 3), indexed by red, green and blue.

        codes_of : r⁻¹, from light (…, 3) to codes.
        """
        steps = np.linspace(0, 1, CELLS) ** 2
        light = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
        factor = np.ones_like(light)
        for _ in range(ROUNDS):
            factor = np.sqrt(factor * self.factor(codes_of(np.minimum(light / factor, 1))))
        return (1 / np.sqrt(factor)).astype(np.float32)

    @cached_property
    def _table(self) -> NDArray[np.float64]:
        return np.array(self.samples, np.float64).reshape(LEVELS, LEVELS, LEVELS, 3)
