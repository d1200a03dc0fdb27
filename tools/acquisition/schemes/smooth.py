"""Replace far light measured in blocks by smooth functions with fewer numbers.

A camera pixel sees dozens of blocks by far light, each with its noise. The same light, interpolated linearly between
the nodes of two grids (tools/factoring/model.py), takes four numbers per pixel, and the noise of neighbours averages
out.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np

from counterlight.arrays import FloatArray
from counterlight.maps.row_map import SparseRows
from counterlight.tools.acquisition.schemes.agreement import parts_of
from counterlight.tools.acquisition.schemes.blocks import with_readable_far
from counterlight.tools.factoring.factoring import grids_over, has_too_many_pixels
from counterlight.tools.factoring.model import PEAK, Rows, fitted, split
from counterlight.tools.inverse.pictures import soft_picture
from counterlight.tools.transport.transport import FarLight, Shape, Transport

MOST_LOST = 0.005  # largest RMS difference of pictures, relative to white: 46 dB


def smoothed(transport: Transport) -> tuple[Transport, str]:
    """Interpolate T's far light between nodes if pictures stay the same and numbers become fewer; returns T and a note.

    transport : T with its pictures' sizes.
    """
    blocks, projector = transport.far, transport.projector
    assert projector is not None
    rows, columns = transport.shape
    if blocks is None or has_too_many_pixels(transport):
        summary = "far light: none" if blocks is None else "far light: left in blocks, of too many pixels"
        return with_readable_far(transport), summary
    alone = _Blocks(replace(transport, near=SparseRows.empty(rows, columns)), np.zeros(0, np.bool_))
    far = split(alone, fitted(alone, grids_over(transport)[-1], PEAK)).far
    assert far is not None
    lost = _lost(transport, blocks, far, projector)
    sizes = [part.scatter.indices.size + part.gather.indices.size for part in (blocks, far)]
    loss = f"pictures by them differ by {100 * lost:.2g} % of white"
    if lost > MOST_LOST or sizes[1] >= sizes[0]:
        said = f"far light: left in {sizes[0]} numbers of blocks; of {sizes[1]} between nodes, {loss}"
        return with_readable_far(transport), said
    said = f"far light: {sizes[0]} numbers of blocks became {sizes[1]} between nodes; {loss}"
    return replace(transport, far=far), said


class _Blocks(Rows):
    """Far light alone. Column sums are computed without a transposed U, which would be as large as U."""

    @cached_property
    def known(self) -> tuple[FloatArray, FloatArray]:
        far, columns = self.transport.far, self.transport.shape[1]
        assert far is not None
        U, sent = far.scatter, np.zeros((far.scatter.columns, 3))
        for part in parts_of(U.indices.size):
            for i in range(3):
                sent[:, i] += np.bincount(U.indices[part], U.weights[part, i], U.columns)
        return far.apply(np.ones((columns, 3))), far.gather.apply_transpose(far.mix.apply_transpose(sent))


def _lost(transport: Transport, blocks: FarLight, far: FarLight, projector: Shape) -> float:
    """Returns the largest RMS difference of far-light pictures, relative to the floodlit room."""
    white = float(np.sqrt(np.mean(transport.composition() ** 2)))
    return max(
        float(np.sqrt(np.mean((blocks.apply(drive) - far.apply(drive)) ** 2))) / white for drive in _drives(projector)
    )


def _drives(projector: Shape) -> list[FloatArray]:
    """Returns a picture whose half is white, and a soft picture, (projector pixels, 3)."""
    half = np.zeros(projector)
    half[:, projector[1] // 2 :] = 1
    return [np.repeat(picture.reshape(-1, 1), 3, axis=1) for picture in (half, soft_picture(projector))]
