"""Packs three scipy matrices into a row map."""

from collections.abc import Sequence

from counterlight.maps.row_map import RowMap, pack
from counterlight.tools.transport.transport import Csr, stacked


def pack_matrices(matrices: Sequence[Csr], output: tuple[int, int], source: tuple[int, int]) -> RowMap:
    """Pack (output pixels, source pixels) matrices for red, green and blue."""
    return pack(stacked([Csr(matrix) for matrix in matrices]), output, source)
