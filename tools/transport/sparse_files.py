"""Sparse matrices in the layout of scipy.sparse.save_npz, in any of its five formats; read once their parts agree.

A matrix has at most as many entries as places, and its index arrays have the lengths that its shape implies. An archive
that claims otherwise is refused by its headers.
"""

from math import prod
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from counterlight.tools.transport.arrays import ArrayError, Members, StoredArray
from counterlight.tools.transport.transport import Csr

Shape: TypeAlias = tuple[int, int]
FORMATS = ("csr", "csc", "bsr", "coo", "dia")


def read_sparse(arrays: Members, shape: Shape) -> Csr:
    """Read the matrix of an archive as float32 CSR; raises ValueError if it is none. shape : already known."""
    stored = arrays["format"].expect("SU")
    name = str(stored.read().astype(np.str_)) if stored.nbytes <= 64 else ""
    if name not in FORMATS:
        raise ArrayError(f"a matrix of the format {name!r}, expected {', '.join(FORMATS)}")
    if name == "coo":
        return _read_coo(arrays, shape)
    return _read_diagonals(arrays, shape) if name == "dia" else read_compressed(arrays, shape, name)


def read_compressed(arrays: Members, shape: Shape, name: str = "csr", prefix: str = "") -> Csr:
    """Read CSR, CSC or BSR: the arrays data, indices and indptr, with a prefix before their names."""
    stored = arrays[f"{prefix}data"]
    block = stored.shape[1:] if name == "bsr" and len(stored.shape) == 3 else ()
    data = _entries(stored, shape, None, *block)
    height, width = block or (1, 1)
    if not (height and width) or shape[0] % height or shape[1] % width:
        raise ArrayError(f"blocks of {height}x{width} in a matrix of {shape[0]}x{shape[1]}")
    lines = shape[1] if name == "csc" else shape[0] // height
    indices = _whole(arrays[f"{prefix}indices"].expect("iu", stored.shape[0]))
    indptr = _whole(arrays[f"{prefix}indptr"].expect("iu", lines + 1))
    kinds = {"csr": sparse.csr_array, "csc": sparse.csc_array, "bsr": sparse.bsr_array}
    matrix = kinds[name]((_real(data), indices, indptr), shape=shape)
    matrix.check_format(full_check=True)
    return _float32(matrix)


def _read_coo(arrays: Members, shape: Shape) -> Csr:
    data = _entries(arrays["data"], shape, None)
    if "coords" in arrays:
        row, column = _whole(arrays["coords"].expect("iu", 2, data.shape[0]))
    else:
        row, column = (_whole(arrays[name].expect("iu", data.shape[0])) for name in ("row", "col"))
    return _float32(sparse.coo_array((_real(data), (row, column)), shape=shape))


def _read_diagonals(arrays: Members, shape: Shape) -> Csr:
    data = arrays["data"].expect("fiu", None, None)
    if data.shape[0] >= sum(shape) or data.shape[1] > shape[1]:
        raise ArrayError(f"{data.shape[0]} diagonals of {data.shape[1]} in a matrix of {shape[0]}x{shape[1]}")
    offsets = _whole(arrays["offsets"].expect("iu", data.shape[0]))
    return _float32(sparse.dia_array((_real(data), offsets), shape=shape))


def _entries(stored: StoredArray, shape: Shape, *lengths: int | None) -> StoredArray:
    if prod(stored.expect("fiu", *lengths).shape) > prod(shape):
        raise ArrayError(f"{prod(stored.shape)} entries in a matrix of {shape[0]}x{shape[1]}")
    return stored


def _real(stored: StoredArray) -> NDArray[np.floating]:
    """Read numbers in a type that scipy supports: float32 if it holds them, else float64, in which they are summed."""
    values = stored.read()
    short = values.dtype.itemsize <= 2 or values.dtype.newbyteorder("=") == np.float32
    return values.astype(np.float32 if short else np.float64, copy=False)


def _whole(stored: StoredArray) -> NDArray[Any]:
    """Read indices; values beyond int64 become negative, which scipy refuses."""
    values = stored.read()
    return values if values.dtype in (np.int32, np.int64) else values.astype(np.int64)


def _float32(matrix: Any) -> Csr:
    with np.errstate(over="ignore"):  # overflow becomes infinite, and is refused
        return sparse.csr_array(matrix.astype(np.float32, copy=False))
