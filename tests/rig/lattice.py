"""The lattice of rays that all cameras of a rig share: four samples per side of a calibrated pixel, and a wider view.

The calibrated camera sees a window of the lattice, in blocks of 4 × 4. The audience's camera stands at the same place
and sees the whole lattice, in blocks of 2 × 2. Both look through one lens, which spreads a sample by ¼, ½, ¼.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from tests.rig.rays import FloatArray

SAMPLES = 4  # samples per side of a calibrated pixel
FINE = 2  # samples per side of an audience's pixel
WIDER = 1.3
SPREAD = 0.25, 0.5, 0.25


@dataclass(frozen=True)
class Lattice:
    """A lattice.

    camera : (height, width) of the calibrated camera's picture.
    """

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
        """Returns (u, v) of every sample in the calibrated camera's pixel coordinates, row by row: (samples,) each."""
        rows, columns = ((np.arange(n) + 0.5) / SAMPLES - more for n, more in zip(self.size, self.border, strict=True))
        v, u = np.meshgrid(rows, columns, indexing="ij")
        return u.ravel(), v.ravel()

    def calibrated(self, moved: tuple[int, int] = (0, 0)) -> sparse.csr_array:
        """Returns the calibrated camera's averages of samples, (camera pixels, samples).

        moved : movement in samples, right and down.
        """
        starts = (more * SAMPLES + shift for more, shift in zip(self.border, moved[::-1], strict=True))
        rows, columns = (
            _averages(n, SAMPLES, start, of) for n, start, of in zip(self.camera, starts, self.size, strict=True)
        )
        return sparse.csr_array(sparse.kron(rows, columns, format="csr"))

    def wide(self) -> sparse.csr_array:
        """Returns the audience's averages of samples, (audience pixels, samples)."""
        rows, columns = (_averages(n, FINE, 0, of) for n, of in zip(self.audience, self.size, strict=True))
        return sparse.csr_array(sparse.kron(rows, columns, format="csr"))


def _averages(pixels: int, block: int, start: int, samples: int) -> sparse.csr_array:
    """Returns (pixels, samples) along one axis: the mean over a block after the lens has spread the samples."""
    kernel = np.convolve(np.ones(block) / block, SPREAD)
    columns = start - 1 + np.arange(pixels)[:, None] * block + np.arange(kernel.size)
    rows = np.broadcast_to(np.arange(pixels)[:, None], columns.shape)
    values = np.broadcast_to(kernel, columns.shape)
    entries = values.ravel(), (rows.ravel(), np.clip(columns, 0, samples - 1).ravel())
    return sparse.csr_array(sparse.coo_array(entries, shape=(pixels, samples)), dtype=np.float32)
