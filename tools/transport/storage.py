"""The transport's files in a calibration folder: transport_*.npz (scipy's layout, no pickle) and far_light.npz."""

import zipfile
import zlib
from pathlib import Path

import numpy as np
from scipy import sparse

from player.calibration import StoredCalibration
from player.errors import InputError
from tools.transport.transport import CHANNELS, Csr, FarLight, Transport

FAR_LIGHT = "far_light.npz"
MAX_BYTES = 16 << 30
# What numpy raises for archives that are damaged, or that claim arrays larger than memory.
UNREADABLE = (
    OSError,
    RuntimeError,
    zlib.error,
    ValueError,
    KeyError,
    EOFError,
    TypeError,
    MemoryError,
    zipfile.BadZipFile,
)


def write_transport(transport: Transport, folder: Path) -> None:
    """Write the three near matrices (float32 CSR) and, if there is far light, its factors."""
    for name, matrix in zip(CHANNELS, transport.near, strict=True):
        sparse.save_npz(folder / f"transport_{name}.npz", matrix.astype(np.float32))
    if transport.far is not None:
        _write_far_light(transport.far, folder / FAR_LIGHT)


def read_transport(stored: StoredCalibration) -> Transport:
    """Read a calibration's transport; InputError when a file is damaged or does not fit the calibration's sizes."""
    calibration = stored.calibration
    shape = calibration.camera.pixels, calibration.projector.pixels
    near = tuple(read_matrix(stored.checked_path(f"transport_{name}.npz"), shape) for name in CHANNELS)
    far = _read_far_light(stored.checked_path(FAR_LIGHT), shape) if FAR_LIGHT in stored.files else None
    stored.refuse_replaced()
    return Transport(near, far)


def read_matrix(path: Path, shape: tuple[int, int]) -> Csr:
    """Read a scipy.sparse .npz as float32 CSR of `shape`, duplicates summed; never unpickles.

    Raises InputError for no such file, another layout, another shape, NaN or infinity, or indices out of range.
    """
    refuse_large_archive(path)
    try:
        matrix = sparse.csr_array(sparse.load_npz(path))
        matrix.check_format(full_check=True)
    except UNREADABLE as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else " ".join(str(error).split())
        raise InputError(f"{path}: no sparse matrix ({reason}); save it with scipy.sparse.save_npz") from None
    if matrix.shape != shape:
        raise InputError(
            f"{path}: {matrix.shape[0]}x{matrix.shape[1]} entries, expected {shape[0]} camera pixels (rows) x "
            f"{shape[1]} projector pixels (columns); check --camera and --projector, or transpose it"
        )
    if matrix.dtype.kind not in "fiu":
        raise InputError(f"{path}: holds {matrix.dtype} values, expected real numbers; save it as float32")
    with np.errstate(over="ignore"):  # what overflows is infinite, and counted below
        matrix = matrix.astype(np.float32)
    matrix.sum_duplicates()
    bad = int(np.count_nonzero(~np.isfinite(matrix.data)))
    if bad:
        raise InputError(f"{path}: {bad} of {matrix.nnz} entries are NaN or infinite; repair the measurement")
    return matrix


def refuse_large_archive(path: Path) -> None:
    """InputError if an .npz claims to unpack to more than 16 GiB; its directory tells, nothing is unpacked."""
    try:
        with zipfile.ZipFile(path) as archive:
            claimed = sum(member.file_size for member in archive.infolist())
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the path") from None
    except (OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: no .npz archive ({error}); save it with scipy.sparse.save_npz") from None
    if claimed > MAX_BYTES:
        raise InputError(f"{path}: unpacks to {claimed >> 20} MiB, at most {MAX_BYTES >> 20} are read; thin it out")


def _write_far_light(far: FarLight, path: Path) -> None:
    arrays = {"mix": far.mix.astype(np.float32), "cells": np.array(far.mix.shape[1])}
    for part, matrices in (("gather", far.gather), ("scatter", far.scatter)):
        for name, matrix in zip(CHANNELS, matrices, strict=True):
            arrays |= {
                f"{part}_{name}_data": matrix.data.astype(np.float32),
                f"{part}_{name}_indices": matrix.indices,
                f"{part}_{name}_indptr": matrix.indptr,
            }
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def _read_far_light(path: Path, shape: tuple[int, int]) -> FarLight:
    refuse_large_archive(path)
    camera_pixels, projector_pixels = shape
    try:
        with np.load(path, allow_pickle=False) as arrays:
            cells = int(arrays["cells"])
            mix = arrays["mix"].astype(np.float64)
            gather = tuple(_factor(arrays, "gather", name, (cells, projector_pixels)) for name in CHANNELS)
            scatter = tuple(_factor(arrays, "scatter", name, (camera_pixels, cells)) for name in CHANNELS)
    except UNREADABLE as error:
        raise InputError(
            f"{path}: not the far light of this calibration ({error}); make the calibration again"
        ) from None
    if mix.shape != (3, cells, cells) or not np.isfinite(mix).all():
        raise InputError(f"{path}: its mix is not a finite 3x{cells}x{cells} array; make the calibration again")
    return FarLight(gather, mix, scatter)


def _factor(arrays: np.lib.npyio.NpzFile, part: str, channel: str, shape: tuple[int, int]) -> Csr:
    data, indices, indptr = (arrays[f"{part}_{channel}_{field}"] for field in ("data", "indices", "indptr"))
    matrix = sparse.csr_array((data, indices, indptr), shape=shape)
    matrix.check_format(full_check=True)
    return matrix
