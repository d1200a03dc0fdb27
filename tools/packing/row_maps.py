"""Pack matrices, channel by channel given, as row maps with one shared pattern."""

from collections.abc import Sequence

from counterlight.row_map import RowMap, SparseRows, pack
from counterlight.tools.transport.transport import Csr, shared_pattern


def pack_matrices(matrices: Sequence[Csr], output_shape: tuple[int, int], source_shape: tuple[int, int]) -> RowMap:
    """Three CSR matrices (output pixels, source pixels) for red, green and blue -> one row map."""
    return pack(SparseRows(*shared_pattern(matrices)), output_shape, source_shape)
