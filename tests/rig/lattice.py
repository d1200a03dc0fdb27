"""The lattice of rays that every camera of a rig shares: four samples a calibrated pixel along each side, and wider.

The calibrated camera sees a window of it, in blocks of 4 × 4; the audience's camera stands at the same place and sees
all of it, in blocks of 2 × 2. Both look through the same lens, which spreads a sample by ¼, ½, ¼.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from tests.rig.rays import FloatArray

SAMPLES = 4  # a calibrated pixel's side
FINE = 2  # of the audience's
WIDER = 1.3
SPREAD = 0.25, 0.5, 0.25


@dataclass(frozen=True)
class Lattice:
    """camera : (height, width) of the calibrated camera's picture."""

    camera: tuple[int, int]

    @property
    def border(self) -> tuple[int, int]:
        """Calibrated pixels (rows, columns) that the audience sees beyond each edge."""
        height, width = self.camera
        return round(height * (WIDER - 1) / 2), round(width * (WIDER - 1) / 2)

    @property
    def size(self) -> tuple[int, int]:
        """(rows, columns) of samples."""
        height, width = ((n + 2 * more) * SAMPLES for n, more in zip(self.camera, self.border, strict=True))
        return height, width

    @property
    def audience(self) -> tuple[int, int]:
        """(height, width) of the audience's picture."""
        return self.size[0] // FINE, self.size[1] // FINE

    def positions(self) -> tuple[FloatArray, FloatArray]:
        """(u, v) of every sample in the calibrated camera's pixel coordinates, row by row: (samples,) twice."""
        rows, columns = ((np.arange(n) + 0.5) / SAMPLES - more for n, more in zip(self.size, self.border, strict=True))
        v, u = np.meshgrid(rows, columns, indexing="ij")
        return u.ravel(), v.ravel()

    def calibrated(self, moved: tuple[int, int] = (0, 0)) -> sparse.csr_array:
        """(camera pixels, samples): what the calibrated camera averages. moved : by so many samples, right and down."""
        starts = (more * SAMPLES + shift for more, shift in zip(self.border, moved[::-1], strict=True))
        rows, columns = (
            _averages(n, SAMPLES, start, of) for n, start, of in zip(self.camera, starts, self.size, strict=True)
        )
        return sparse.csr_array(sparse.kron(rows, columns, format="csr"))

    def wide(self) -> sparse.csr_array:
        """(audience pixels, samples)."""
        rows, columns = (_averages(n, FINE, 0, of) for n, of in zip(self.audience, self.size, strict=True))
        return sparse.csr_array(sparse.kron(rows, columns, format="csr"))


def _averages(pixels: int, block: int, start: int, samples: int) -> sparse.csr_array:
    """(pixels, samples) along one axis: mean over a block of what the lens has spread."""
    kernel = np.convolve(np.ones(block) / block, SPREAD)
    columns = start - 1 + np.arange(pixels)[:, None] * block + np.arange(kernel.size)
    rows = np.broadcast_to(np.arange(pixels)[:, None], columns.shape)
    values = np.broadcast_to(kernel, columns.shape)
    entries = values.ravel(), (rows.ravel(), np.clip(columns, 0, samples - 1).ravel())
    return sparse.csr_array(sparse.coo_array(entries, shape=(pixels, samples)), dtype=np.float32)
