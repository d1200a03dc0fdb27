"""The rows of T⁺ for unseen projector pixels, if the picture shall continue there (`--outside continue`)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from counterlight.raster import Region
from counterlight.tools.inverse.near_light import Inverse
from counterlight.tools.transport.objective import owners


def continued(inverse: Inverse, projector: tuple[int, int], regions: Sequence[Region]) -> Inverse:
    """Give each unseen pixel the row of its projector's nearest seen pixel. Steps with ties then make the result
    smooth.

    projector : (height, width) of the raster.
    """
    owner, seen = owners(projector, regions), (inverse.T_pinv.lengths > 0).reshape(projector)
    source = np.arange(owner.size).reshape(projector)
    for number in range(int(owner.max()) + 1):
        known, lost = (owner == number) & seen, (owner == number) & ~seen
        if known.any():
            y, x = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
            source[lost] = (y * projector[1] + x)[lost]
    rows = source.ravel()
    return replace(inverse, T_pinv=inverse.T_pinv.at(rows), truncation=inverse.truncation[rows])
