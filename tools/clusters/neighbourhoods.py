"""ComputeNeighborhoodBlocks of Appendix A, compiled by Numba on first use and cached for the next start.

A camera pixel of a dense T has thousands of blocks of a few additions each; numpy would scan the remaining graph again
for every block.
"""

import numpy as np
from numpy.typing import NDArray

from counterlight.arrays import IntArray
from counterlight.maps.products import kept
from counterlight.tools.clusters.connections import Connections


def strongest_of_block(
    graph: Connections, order: IntArray, projector_shape: tuple[int, int], radius: float
) -> IntArray:
    """Return the strongest connection of each connection's block.

    order : connections by camera pixel, strongest first.
    projector_shape : (height, width).

    Returns (connections,), indices of connections.
    """
    if radius < 1:
        return np.arange(order.size)
    return np.asarray(_strongest(order, graph.ends, graph.projector, *projector_shape, float(radius)))


@kept()
def _strongest(
    order: NDArray[np.int64],
    ends: NDArray[np.int64],
    projector: NDArray[np.int64],
    height: int,
    width: int,
    radius: float,
) -> NDArray[np.int64]:
    """Paint discs, per camera pixel, around its strongest connections that no disc covers yet.

    ends : (camera pixels,). End of each camera pixel's connections in `order`.
    """
    strongest = np.empty(order.size, np.int64)
    painted_by, middle = np.full((height, width), -1), np.empty((height, width), np.int64)
    reach = int(min(radius, height + width))
    start = 0
    for camera_pixel in range(ends.size):
        for connection in order[start : ends[camera_pixel]]:
            y, x = divmod(projector[connection], width)
            if painted_by[y, x] != camera_pixel:
                for v in range(max(y - reach, 0), min(y + reach + 1, height)):
                    for u in range(max(x - reach, 0), min(x + reach + 1, width)):
                        inside = (v - y) ** 2 + (u - x) ** 2 <= radius * radius
                        if inside and painted_by[v, u] != camera_pixel:
                            painted_by[v, u], middle[v, u] = camera_pixel, connection
            strongest[connection] = middle[y, x]
        start = ends[camera_pixel]
    return strongest
